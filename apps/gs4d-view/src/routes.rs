//! Paths of the server: the files of the page, and the WebSocket. Each is checked by the [`Guard`](crate::guard::Guard).

use crate::client::{self, Place};
use crate::dropped;
use crate::question::MAX_BYTES;
use crate::server::Shared;
use axum::Router;
use axum::extract::State;
use axum::extract::ws::WebSocketUpgrade;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use std::sync::Arc;

/// Content policy of the page: its own files, images made from answers, and the connection to this server.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src blob: data:; connect-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Files of the page: path, content type and content.
const FILES: [(&str, &str, &str); 15] = [
    ("/app.js", "text/javascript", include_str!("page/app.js")),
    ("/ask.js", "text/javascript", include_str!("page/ask.js")),
    ("/camera.js", "text/javascript", include_str!("page/camera.js")),
    ("/input.js", "text/javascript", include_str!("page/input.js")),
    ("/local.js", "text/javascript", include_str!("page/local.js")),
    ("/overlay.js", "text/javascript", include_str!("page/overlay.js")),
    ("/panel.js", "text/javascript", include_str!("page/panel.js")),
    ("/selection.js", "text/javascript", include_str!("page/selection.js")),
    ("/sort.js", "text/javascript", gs4d_player::SORT_JS),
    ("/vectors.js", "text/javascript", gs4d_player::VECTORS_JS),
    ("/splats.js", "text/javascript", gs4d_player::SPLATS_JS),
    ("/timeline.js", "text/javascript", include_str!("page/timeline.js")),
    ("/tools.js", "text/javascript", include_str!("page/tools.js")),
    ("/training.js", "text/javascript", include_str!("page/training.js")),
    ("/app.css", "text/css", include_str!("page/app.css")),
];

/// All paths of the server.
pub(crate) fn routes(shared: Arc<Shared>) -> Router {
    let mut router = Router::new().route("/", get(page)).route("/ws", get(connect)).route("/drop", post(dropped::take));
    for (path, kind, content) in FILES {
        router = router.route(path, get(move |s: State<Arc<Shared>>, h: HeaderMap| file(s, h, kind, content)));
    }
    router.with_state(shared)
}

fn text_of(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|v| v.to_str().ok())
}

/// The token in a query `k=…`.
fn token_of(uri: &Uri) -> Option<&str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix("k="))
}

/// The refusal of a request that is not of a page of this server with the key.
pub(crate) fn stranger(shared: &Shared, headers: &HeaderMap, uri: &Uri) -> Option<Response> {
    let guard = &shared.guard;
    if !guard.host(text_of(headers, header::HOST)) || !guard.origin(text_of(headers, header::ORIGIN)) {
        return Some(refuse("not a page of this server"));
    }
    (!guard.knows(token_of(uri))).then(|| refuse("wrong key"))
}

fn refuse(why: &'static str) -> Response {
    (StatusCode::FORBIDDEN, why).into_response()
}

/// A file of the page, with restrictive headers.
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
    if let Some(refusal) = stranger(&shared, &headers, &uri) {
        return refusal;
    }
    let Some(place) = Place::take(&shared) else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many viewers").into_response();
    };
    // The place is free again if the upgrade fails.
    upgrade.max_message_size(MAX_BYTES).max_frame_size(MAX_BYTES).on_upgrade(async move |socket| {
        client::serve(socket, &shared).await;
        drop(place);
    })
}
