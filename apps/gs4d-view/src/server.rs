//! The server: one page, one WebSocket per browser, the newest question first.

use crate::ViewError;
use crate::guard::Guard;
use crate::live::{Feed, Pace, THREAD_NAME};
use crate::packing::Packing;
use crate::picture::Renderer;
use crate::question::{MAX_BYTES, MAX_NESTING, Question, nesting};
use crate::stage::Stage;
use axum::Router;
use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use gs_core::cast;
use gs_data::avatar::AvatarScene;
use gs_train::registry::Registry;
use serde_json::{Value, json};
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot, watch};

/// Ports tried after the one asked for.
const EXTRA_PORTS: u16 = 20;
/// Most browsers connected at once.
const MAX_CLIENTS: usize = 32;
/// A browser that does not take a message within this time, plus its size at [`MIN_RATE`], is disconnected.
const SEND_TIMEOUT: Duration = Duration::from_secs(10);
/// Bytes per second.
const MIN_RATE: f64 = 100e3;
/// A browser without a question for this long is disconnected.
const IDLE_TIMEOUT: Duration = Duration::from_secs(3600);
/// Content policy of the page: its own files, images made from answers, and the connection to this server.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src blob: data:; connect-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Where the server listens and how much of the machine it uses.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Address to listen at; loopback unless other machines are to connect.
    pub host: IpAddr,
    /// First port tried; the next 20 follow.
    pub port: u16,
    /// Format of the images sent.
    pub packing: Packing,
    /// Share of the machine for rendering, on one thread; `None`: all threads without limit.
    pub share: Option<f64>,
}

/// A running viewer; dropping it stops the server.
pub struct Server {
    /// Address and port it listens at.
    pub address: SocketAddr,
    /// Address to open in a browser, with the token.
    pub url: String,
    shared: Arc<Shared>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Server {
    /// The feed for the training run that is the first show.
    ///
    /// # Errors
    /// [`ViewError::Threads`] if its thread cannot be started.
    pub fn feed(&self, registry: Registry, avatar: Option<Arc<AvatarScene>>) -> Result<Feed, ViewError> {
        let share = self.shared.half_share.unwrap_or(1.0);
        Feed::start(registry, self.shared.clone(), avatar, share).map_err(ViewError::Threads)
    }
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

/// State shared by all connections.
pub(crate) struct Shared {
    pub(crate) stage: Stage,
    guard: Guard,
    packing: Packing,
    renderer: Mutex<Renderer>,
    /// Connected browsers.
    pub(crate) clients: AtomicUsize,
    /// Newest message to all browsers.
    pub(crate) news: watch::Sender<Option<String>>,
    /// Half of [`Options::share`].
    half_share: Option<f64>,
    pace: Option<Pace>,
    /// The single render thread, if the share is limited.
    pool: Option<rayon::ThreadPool>,
}

impl Shared {
    fn new(stage: Stage, guard: Guard, options: &Options) -> Result<Self, ViewError> {
        let half_share = options.share.map(|s| 0.5 * s);
        let one = || rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(|_| THREAD_NAME.into()).build();
        let pool = half_share.map(|_| one()).transpose();
        Ok(Self {
            stage,
            guard,
            packing: options.packing,
            renderer: Mutex::default(),
            clients: AtomicUsize::new(0),
            news: watch::Sender::new(None),
            half_share,
            pace: half_share.map(Pace::of),
            pool: pool.map_err(|e| ViewError::Threads(std::io::Error::other(e)))?,
        })
    }

    /// Runs `work` on the single render thread if the share is limited, else in the global pool.
    pub(crate) fn in_pool<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

/// Starts a server in its own threads.
///
/// # Errors
/// If there is no show, no free port, or threads cannot be started.
///
/// ```
/// use gs4d_view::{Options, Packing, Show, Stage, start};
/// let stage = Stage { shows: vec![Show::splats("empty".into(), gs_core::Splats::default())] };
/// let options = Options { host: [127, 0, 0, 1].into(), port: 18_900, packing: Packing::Png, share: None };
/// let server = start(stage, &options)?;
/// assert!(server.url.starts_with("http://127.0.0.1:189") && server.url.contains("/?k="));
/// # Ok::<(), gs4d_view::ViewError>(())
/// ```
pub fn start(stage: Stage, options: &Options) -> Result<Server, ViewError> {
    if stage.shows.is_empty() {
        return Err(ViewError::Nothing);
    }
    let listener = listen(options.host, options.port)?;
    let address = listener.local_addr().map_err(ViewError::Threads)?;
    let guard = Guard::new(address);
    let url = format!("http://{address}/?k={}", guard.token());
    let shared = Arc::new(Shared::new(stage, guard, options)?);
    let kept = shared.clone();
    let mut runtime = tokio::runtime::Builder::new_multi_thread();
    let runtime = runtime.worker_threads(2).thread_name(THREAD_NAME).enable_all().build();
    let runtime = runtime.map_err(ViewError::Threads)?;
    let (stop, stopped) = oneshot::channel();
    let thread = std::thread::Builder::new().name(THREAD_NAME.into()).spawn(move || {
        runtime.block_on(async {
            let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
            tokio::select! {
                _ = axum::serve(listener, routes(kept)) => {}
                _ = stopped => {}
            }
        });
        runtime.shutdown_timeout(Duration::from_secs(1));
    });
    Ok(Server { address, url, shared, stop: Some(stop), thread: Some(thread.map_err(ViewError::Threads)?) })
}

/// The first free port from `first` on.
fn listen(host: IpAddr, first: u16) -> Result<TcpListener, ViewError> {
    let last = first.saturating_add(EXTRA_PORTS);
    let mut source = std::io::Error::other("no port was tried");
    for port in first..=last {
        match TcpListener::bind((host, port)).and_then(|l| l.set_nonblocking(true).map(|()| l)) {
            Ok(listener) => return Ok(listener),
            Err(e) => source = e,
        }
    }
    Err(ViewError::Port { host, first, last, source })
}

/// Files of the page: path, content type and content.
const FILES: [(&str, &str, &str); 5] = [
    ("/camera.js", "text/javascript", include_str!("page/camera.js")),
    ("/status.js", "text/javascript", include_str!("page/status.js")),
    ("/ask.js", "text/javascript", include_str!("page/ask.js")),
    ("/app.js", "text/javascript", include_str!("page/app.js")),
    ("/app.css", "text/css", include_str!("page/app.css")),
];

fn routes(shared: Arc<Shared>) -> Router {
    let mut router = Router::new().route("/", get(page)).route("/ws", get(connect));
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
    let guard = &shared.guard;
    if !guard.host(text_of(&headers, header::HOST)) || !guard.origin(text_of(&headers, header::ORIGIN)) {
        return refuse("not a page of this server");
    }
    if !guard.knows(token_of(&uri)) {
        return refuse("wrong key");
    }
    if shared.clients.fetch_add(1, Ordering::SeqCst) >= MAX_CLIENTS {
        shared.clients.fetch_sub(1, Ordering::SeqCst);
        return (StatusCode::SERVICE_UNAVAILABLE, "too many viewers").into_response();
    }
    let upgrade = upgrade.max_message_size(MAX_BYTES).max_frame_size(MAX_BYTES);
    let left = shared.clone();
    upgrade
        .on_failed_upgrade(move |_| {
            left.clients.fetch_sub(1, Ordering::SeqCst);
        })
        .on_upgrade(async move |socket| {
            serve_client(socket, &shared).await;
            shared.clients.fetch_sub(1, Ordering::SeqCst);
        })
}

/// Serves one browser: receives questions, of which only the newest is kept, and sends answers and news.
async fn serve_client(mut socket: WebSocket, shared: &Arc<Shared>) {
    let (wanted, newest) = watch::channel::<Option<Question>>(None);
    let (done, mut answers) = mpsc::channel::<Message>(1);
    let mut news = shared.news.subscribe();
    let worker = tokio::spawn(answer_newest(shared.clone(), newest, done));
    let mut greeting = shared.stage.about();
    greeting["version"] = json!(env!("CARGO_PKG_VERSION"));
    if send(&mut socket, text_message(&greeting)).await {
        loop {
            let alive = tokio::select! {
                message = tokio::time::timeout(IDLE_TIMEOUT, socket.recv()) => match message {
                    Ok(Some(Ok(Message::Text(text)))) if nesting(&text) > MAX_NESTING => false,
                    Ok(Some(Ok(Message::Text(text)))) => match Question::parse(&text) {
                        Ok(question) => {
                            wanted.send_replace(Some(question));
                            true
                        }
                        Err(why) => send(&mut socket, text_message(&json!({"error": why}))).await,
                    },
                    Ok(Some(Ok(Message::Ping(_) | Message::Pong(_)))) => true,
                    _ => false,
                },
                Some(answer) = answers.recv() => send(&mut socket, answer).await,
                Ok(()) = news.changed() => {
                    let text = news.borrow_and_update().clone();
                    send(&mut socket, Message::Text(text.unwrap_or_default().into())).await
                }
            };
            if !alive {
                break;
            }
        }
    }
    worker.abort();
    let bye = CloseFrame { code: 1000, reason: "".into() };
    let _ = tokio::time::timeout(SEND_TIMEOUT, socket.send(Message::Close(Some(bye)))).await;
}

/// Answers the newest question in a loop, within the share of the machine.
async fn answer_newest(
    shared: Arc<Shared>,
    mut newest: watch::Receiver<Option<Question>>,
    done: mpsc::Sender<Message>,
) {
    while newest.changed().await.is_ok() {
        if let Some(pace) = &shared.pace {
            tokio::time::sleep_until(pace.ready().into()).await;
        }
        let Some(question) = newest.borrow_and_update().clone() else { continue };
        let state = shared.clone();
        let answer = tokio::task::spawn_blocking(move || answer(&state, &question)).await;
        let answer = answer.unwrap_or_else(|_| text_message(&json!({"error": "the image could not be rendered"})));
        if done.send(answer).await.is_err() {
            break;
        }
    }
}

/// Sends a message; false if it timed out or failed.
async fn send(socket: &mut WebSocket, message: Message) -> bool {
    let bytes = match &message {
        Message::Binary(bytes) => bytes.len(),
        _ => 0,
    };
    let time = SEND_TIMEOUT + Duration::from_secs_f64(bytes as f64 / MIN_RATE);
    matches!(tokio::time::timeout(time, socket.send(message)).await, Ok(Ok(())))
}

fn text_message(value: &Value) -> Message {
    Message::Text(value.to_string().into())
}

/// The answer as one binary message: length of the header (u32, little-endian), header (JSON), image or file.
fn answer(shared: &Shared, question: &Question) -> Message {
    let mut renderer = shared.renderer.lock().unwrap_or_else(PoisonError::into_inner);
    let renderer: &mut Renderer = &mut renderer;
    let begun = Instant::now();
    let answer = shared.in_pool(|| renderer.answer(&shared.stage, question, shared.packing));
    if let Some(pace) = &shared.pace {
        pace.spent(begun.elapsed());
    }
    match answer {
        Ok(answer) => {
            let header = answer.header.to_string().into_bytes();
            let mut bytes = Vec::with_capacity(4 + header.len() + answer.bytes.len());
            bytes.extend(cast::to_u32(header.len()).to_le_bytes());
            bytes.extend(header);
            bytes.extend(answer.bytes);
            Message::Binary(bytes.into())
        }
        Err(why) => text_message(&json!({"id": question.id, "error": why})),
    }
}
