//! The server: one page, one WebSocket per browser, the newest question first.

use crate::ViewError;
use crate::guard::Guard;
use crate::picture::{Packing, Painter};
use crate::question::{MOST_BYTES, Question};
use crate::stage::Stage;
use axum::Router;
use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde_json::{Value, json};
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};

/// Ports tried after the one asked for.
const MORE_PORTS: u16 = 20;
/// Browsers at once.
const MOST_CLIENTS: usize = 32;
/// A browser that does not take a picture in this time is let go.
const SLOW: Duration = Duration::from_secs(10);
/// So is one that asks nothing for this long.
const IDLE: Duration = Duration::from_secs(3600);
/// What a page may load and do: itself, pictures made of answers, a connection to where it came from.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src blob: data:; connect-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// How to serve.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Address to listen at; loopback unless others are meant to look.
    pub host: IpAddr,
    /// First port tried.
    pub port: u16,
    /// How pictures are packed.
    pub packing: Packing,
}

/// A viewer that runs until it is stopped or dropped.
pub struct Server {
    /// Where it listens.
    pub address: SocketAddr,
    /// What to open: holds the token.
    pub url: String,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            // The thread may have ended already.
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What all connections share.
struct Shared {
    stage: Stage,
    guard: Guard,
    packing: Packing,
    painter: Mutex<Painter>,
    clients: AtomicUsize,
}

/// Starts serving in threads of its own.
///
/// # Errors
/// Nothing to show, no free port, or no threads.
pub fn start(stage: Stage, options: &Options) -> Result<Server, ViewError> {
    if stage.shows.is_empty() {
        return Err(ViewError::Nothing);
    }
    let listener = listen(options.host, options.port)?;
    let address = listener.local_addr().map_err(ViewError::Threads)?;
    let guard = Guard::new(address);
    let url = format!("http://{address}/?k={}", guard.token());
    let shared = Arc::new(Shared {
        stage,
        guard,
        packing: options.packing,
        painter: Mutex::default(),
        clients: AtomicUsize::new(0),
    });
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(ViewError::Threads)?;
    let (stop, stopped) = oneshot::channel();
    let thread = std::thread::Builder::new().name("gs4d-view".into()).spawn(move || {
        runtime.block_on(async {
            let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
            tokio::select! {
                _ = axum::serve(listener, routes(shared)) => {}
                _ = stopped => {}
            }
        });
        runtime.shutdown_timeout(Duration::from_secs(1));
    });
    Ok(Server { address, url, stop: Some(stop), thread: Some(thread.map_err(ViewError::Threads)?) })
}

/// The first free port from `first` on.
fn listen(host: IpAddr, first: u16) -> Result<TcpListener, ViewError> {
    let last = first.saturating_add(MORE_PORTS);
    let mut source = std::io::Error::other("no port was tried");
    for port in first..=last {
        match TcpListener::bind((host, port)).and_then(|l| l.set_nonblocking(true).map(|()| l)) {
            Ok(listener) => return Ok(listener),
            Err(e) => source = e,
        }
    }
    Err(ViewError::Port { host, first, last, source })
}

fn routes(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(page))
        .route(
            "/app.js",
            get(|s: State<Arc<Shared>>, h: HeaderMap| file(s, h, "text/javascript", include_str!("page/app.js"))),
        )
        .route(
            "/app.css",
            get(|s: State<Arc<Shared>>, h: HeaderMap| file(s, h, "text/css", include_str!("page/app.css"))),
        )
        .route("/ws", get(connect))
        .with_state(shared)
}

fn text_of(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|v| v.to_str().ok())
}

/// The token in a query `k=…`.
fn token_of(uri: &Uri) -> Option<&str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix("k="))
}

fn refuse(why: &'static str) -> Response {
    (StatusCode::FORBIDDEN, why).into_response()
}

/// A part of the page, with headers that let it do no more than it must.
async fn file(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    kind: &'static str,
    content: &'static str,
) -> Response {
    if !shared.guard.host(text_of(&headers, header::HOST)) {
        return refuse("this server has another name");
    }
    let mut response = content.into_response();
    let set = [
        (header::CONTENT_TYPE, kind),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::CACHE_CONTROL, "no-store"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    for (name, value) in set {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn page(state: State<Arc<Shared>>, headers: HeaderMap, uri: Uri) -> Response {
    if !state.guard.knows(token_of(&uri)) {
        return refuse("open the whole address that gs4d printed: it ends in a key");
    }
    file(state, headers, "text/html; charset=utf-8", include_str!("page/index.html")).await
}

async fn connect(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    let guard = &shared.guard;
    if !guard.host(text_of(&headers, header::HOST)) || !guard.origin(text_of(&headers, header::ORIGIN)) {
        return refuse("not a page of this server");
    }
    if !guard.knows(token_of(&uri)) {
        return refuse("wrong key");
    }
    if shared.clients.fetch_add(1, Ordering::SeqCst) >= MOST_CLIENTS {
        shared.clients.fetch_sub(1, Ordering::SeqCst);
        return (StatusCode::SERVICE_UNAVAILABLE, "too many viewers").into_response();
    }
    let upgrade = upgrade.max_message_size(MOST_BYTES).max_frame_size(MOST_BYTES);
    let left = shared.clone();
    upgrade
        .on_failed_upgrade(move |_| {
            left.clients.fetch_sub(1, Ordering::SeqCst);
        })
        .on_upgrade(async move |socket| {
            talk(socket, &shared).await;
            shared.clients.fetch_sub(1, Ordering::SeqCst);
        })
}

/// One browser: questions come in, of which only the newest waits; answers go out.
async fn talk(mut socket: WebSocket, shared: &Arc<Shared>) {
    let (wanted, mut newest) = watch::channel::<Option<Question>>(None);
    let (done, mut answers) = mpsc::channel::<Message>(1);
    let drawing = shared.clone();
    let worker = tokio::spawn(async move {
        while newest.changed().await.is_ok() {
            let Some(question) = newest.borrow_and_update().clone() else { continue };
            let shared = drawing.clone();
            let answer = tokio::task::spawn_blocking(move || answer(&shared, &question)).await;
            let answer = answer.unwrap_or_else(|_| say(&json!({"error": "the picture could not be made"})));
            if done.send(answer).await.is_err() {
                break;
            }
        }
    });
    let mut greeting = shared.stage.about();
    greeting["version"] = json!(env!("CARGO_PKG_VERSION"));
    if send(&mut socket, say(&greeting)).await {
        loop {
            let alive = tokio::select! {
                message = tokio::time::timeout(IDLE, socket.recv()) => match message {
                    Ok(Some(Ok(Message::Text(text)))) => match Question::parse(&text) {
                        Ok(question) => {
                            wanted.send_replace(Some(question));
                            true
                        }
                        Err(why) => send(&mut socket, say(&json!({"error": why}))).await,
                    },
                    Ok(Some(Ok(Message::Ping(_) | Message::Pong(_)))) => true,
                    _ => false,
                },
                Some(answer) = answers.recv() => send(&mut socket, answer).await,
            };
            if !alive {
                break;
            }
        }
    }
    worker.abort();
    let bye = CloseFrame { code: 1000, reason: "".into() };
    let _ = tokio::time::timeout(SLOW, socket.send(Message::Close(Some(bye)))).await;
}

/// Whether a message went out in time.
async fn send(socket: &mut WebSocket, message: Message) -> bool {
    matches!(tokio::time::timeout(SLOW, socket.send(message)).await, Ok(Ok(())))
}

fn say(value: &Value) -> Message {
    Message::Text(value.to_string().into())
}

/// The length of the header in four bytes, little end first, the header as JSON, the picture.
fn answer(shared: &Shared, question: &Question) -> Message {
    let mut painter = shared.painter.lock().unwrap_or_else(PoisonError::into_inner);
    match painter.answer(&shared.stage, question, shared.packing) {
        Ok(answer) => {
            let header = answer.header.to_string().into_bytes();
            let mut bytes = Vec::with_capacity(4 + header.len() + answer.image.len());
            bytes.extend((header.len() as u32).to_le_bytes());
            bytes.extend(header);
            bytes.extend(answer.image);
            Message::Binary(bytes.into())
        }
        Err(why) => say(&json!({"id": question.id, "error": why})),
    }
}
