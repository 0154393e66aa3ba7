//! Connections that have not become a WebSocket: how many are open at once, and for how long.
//!
//! A connection whose request does not come holds a file descriptor of the process, and a training needs some for its
//! checkpoints. So at most [`MAX_REQUESTS`] are open, each for a limited time, whatever it has sent. Where one more comes, the
//! oldest is closed: silent connections keep nobody out.

use crate::dropped::Upload;
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;

/// Most such connections. With the browsers ([`MAX_CLIENTS`](crate::client::MAX_CLIENTS)) that is 64 connections in all.
pub(crate) const MAX_REQUESTS: usize = 32;
/// Longest head of a request, bytes.
const MAX_HEAD: usize = 16 << 10;
/// How long a file of a page with the key may take besides.
const UPLOAD_TIME: Duration = Duration::from_secs(600);
/// Pause after a connection that could not be accepted.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Serves connections until it is dropped, each for `limit` or until it is a WebSocket.
pub(crate) async fn serve(listener: TcpListener, routes: Router, limit: Duration) {
    let mut open: VecDeque<JoinHandle<()>> = VecDeque::new();
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // The process may have no descriptor left.
            tokio::time::sleep(ACCEPT_PAUSE).await;
            continue;
        };
        open.retain(|connection| !connection.is_finished());
        if open.len() >= MAX_REQUESTS
            && let Some(oldest) = open.pop_front()
        {
            oldest.abort();
            // Its connection is closed once the task has ended.
            let _ = oldest.await;
        }
        open.push_back(tokio::spawn(one(stream, routes.clone(), limit)));
    }
}

/// Serves the requests of a connection.
async fn one(stream: TcpStream, routes: Router, limit: Duration) {
    let upload = Upload::default();
    let routes = routes.layer(Extension(upload.clone()));
    let connection = http1::Builder::new()
        .max_buf_size(MAX_HEAD)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes))
        .with_upgrades();
    let mut connection = std::pin::pin!(connection);
    // Faults of a connection concern its client alone.
    let ended = tokio::time::timeout(limit, &mut connection).await.is_ok();
    if !ended && upload.0.load(Ordering::SeqCst) {
        let _ = tokio::time::timeout(UPLOAD_TIME, connection).await;
    }
}
