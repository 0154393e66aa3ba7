//! A browser of few words.

use gs4d_view::Server;
use serde_json::Value;
use std::net::TcpStream;
use std::time::Duration;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

pub fn key(server: &Server) -> &str {
    server.url.split_once("k=").unwrap().1
}

/// A browser's WebSocket, with headers of our choice.
pub fn connect(server: &Server, key: &str, origin: Option<&str>) -> Result<WebSocket<TcpStream>, String> {
    let mut request = format!("ws://{}/ws?k={key}", server.address).into_client_request().unwrap();
    if let Some(origin) = origin {
        request.headers_mut().insert("origin", origin.parse().unwrap());
    }
    let stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    tungstenite::client(request, stream).map(|(socket, _)| socket).map_err(|e| e.to_string())
}

pub fn greeted(server: &Server) -> (WebSocket<TcpStream>, Value) {
    let mut socket = connect(server, key(server), None).unwrap();
    let text = socket.read().unwrap();
    let about = serde_json::from_str(text.to_text().unwrap()).unwrap();
    (socket, about)
}

pub fn ask(socket: &mut WebSocket<TcpStream>, question: &Value) -> (Value, Vec<u8>) {
    socket.send(Message::Text(question.to_string().into())).unwrap();
    answer(socket)
}

/// The next answer: its header, and an image or a file, which may come in several messages.
pub fn answer(socket: &mut WebSocket<TcpStream>) -> (Value, Vec<u8>) {
    let mut bytes = match socket.read().unwrap() {
        Message::Binary(bytes) => bytes.to_vec(),
        Message::Text(text) => return (serde_json::from_str(&text).unwrap(), Vec::new()),
        Message::Ping(_) => return answer(socket),
        other => panic!("{other:?}"),
    };
    let [head, body] = [0, 4].map(|at| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize);
    while bytes.len() < 8 + head + body {
        bytes.extend(socket.read().unwrap().into_data());
    }
    assert_eq!(bytes.len(), 8 + head + body);
    let image = bytes.split_off(8 + head);
    (serde_json::from_slice(&bytes[8..]).unwrap(), image)
}
