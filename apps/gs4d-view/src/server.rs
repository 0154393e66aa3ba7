//! The server: one page, one WebSocket per browser, the newest question first.

use crate::ViewError;
use crate::guard::Guard;
use crate::live::{Feed, Pace, THREADS};
use crate::packing::Packing;
use crate::picture::Renderer;
use crate::question::{MOST_BYTES, MOST_NESTING, Question, nesting};
use crate::stage::Stage;
use axum::Router;
use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use gs_data::avatar::AvatarScene;
use gs_train::registry::Registry;
use serde_json::{Value, json};
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot, watch};

/// Ports tried after the one asked for.
const MORE_PORTS: u16 = 20;
/// Browsers at once.
const MOST_CLIENTS: usize = 32;
/// A browser that does not take a message in this time and at [`LEAST_RATE`] is let go.
const SLOW: Duration = Duration::from_secs(10);
/// Bytes a second.
const LEAST_RATE: f64 = 100e3;
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
    /// The share of the machine that drawing may take, by one thread; none: all of it.
    pub share: Option<f64>,
}

/// A viewer that runs until it is stopped or dropped.
pub struct Server {
    /// Where it listens.
    pub address: SocketAddr,
    /// What to open: holds the token.
    pub url: String,
    shared: Arc<Shared>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Server {
    /// Where a run under training, the first show, brings its state.
    ///
    /// # Errors
    /// If there is no thread for it.
    pub fn feed(&self, registry: Registry, avatar: Option<Arc<AvatarScene>>) -> Result<Feed, ViewError> {
        let share = self.shared.half.unwrap_or(1.0);
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

/// What all connections share.
pub(crate) struct Shared {
    pub(crate) stage: Stage,
    guard: Guard,
    packing: Packing,
    renderer: Mutex<Renderer>,
    /// Browsers that are connected.
    pub(crate) clients: AtomicUsize,
    /// What all browsers are told, the newest.
    pub(crate) news: watch::Sender<Option<String>>,
    /// Half of the share of the machine, where there is one.
    half: Option<f64>,
    pace: Option<Pace>,
    /// The one thread that draws, where a share is to be kept.
    pool: Option<rayon::ThreadPool>,
}

impl Shared {
    fn new(stage: Stage, guard: Guard, options: &Options) -> Result<Self, ViewError> {
        let half = options.share.map(|s| 0.5 * s);
        let one = || rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(|_| THREADS.into()).build();
        let pool = half.map(|_| one()).transpose();
        Ok(Self {
            stage,
            guard,
            packing: options.packing,
            renderer: Mutex::default(),
            clients: AtomicUsize::new(0),
            news: watch::Sender::new(None),
            half,
            pace: half.map(Pace::of),
            pool: pool.map_err(|e| ViewError::Threads(std::io::Error::other(e)))?,
        })
    }

    /// Works on the one thread if a share is to be kept, on all of them otherwise.
    pub(crate) fn alone<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
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
    let shared = Arc::new(Shared::new(stage, guard, options)?);
    let kept = shared.clone();
    let mut runtime = tokio::runtime::Builder::new_multi_thread();
    let runtime = runtime.worker_threads(2).thread_name(THREADS).enable_all().build();
    let runtime = runtime.map_err(ViewError::Threads)?;
    let (stop, stopped) = oneshot::channel();
    let thread = std::thread::Builder::new().name(THREADS.into()).spawn(move || {
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

/// Parts of the page: path, kind and content.
const PARTS: [(&str, &str, &str); 5] = [
    ("/look.js", "text/javascript", include_str!("page/look.js")),
    ("/tell.js", "text/javascript", include_str!("page/tell.js")),
    ("/ask.js", "text/javascript", include_str!("page/ask.js")),
    ("/app.js", "text/javascript", include_str!("page/app.js")),
    ("/app.css", "text/css", include_str!("page/app.css")),
];

fn routes(shared: Arc<Shared>) -> Router {
    let mut router = Router::new().route("/", get(page)).route("/ws", get(connect));
    for (path, kind, content) in PARTS {
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

/// One browser: questions come in, of which only the newest waits; answers and news go out.
async fn talk(mut socket: WebSocket, shared: &Arc<Shared>) {
    let (wanted, newest) = watch::channel::<Option<Question>>(None);
    let (done, mut answers) = mpsc::channel::<Message>(1);
    let mut news = shared.news.subscribe();
    let worker = tokio::spawn(draw(shared.clone(), newest, done));
    let mut greeting = shared.stage.about();
    greeting["version"] = json!(env!("CARGO_PKG_VERSION"));
    if send(&mut socket, say(&greeting)).await {
        loop {
            let alive = tokio::select! {
                message = tokio::time::timeout(IDLE, socket.recv()) => match message {
                    Ok(Some(Ok(Message::Text(text)))) if nesting(&text) > MOST_NESTING => false,
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
                Ok(()) = news.changed() => {
                    let told = news.borrow_and_update().clone();
                    send(&mut socket, Message::Text(told.unwrap_or_default().into())).await
                }
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

/// Answers the newest question, again and again, at the pace there is.
async fn draw(shared: Arc<Shared>, mut newest: watch::Receiver<Option<Question>>, done: mpsc::Sender<Message>) {
    while newest.changed().await.is_ok() {
        if let Some(pace) = &shared.pace {
            tokio::time::sleep_until(pace.ready().into()).await;
        }
        let Some(question) = newest.borrow_and_update().clone() else { continue };
        let drawing = shared.clone();
        let answer = tokio::task::spawn_blocking(move || answer(&drawing, &question)).await;
        let answer = answer.unwrap_or_else(|_| say(&json!({"error": "the picture could not be made"})));
        if done.send(answer).await.is_err() {
            break;
        }
    }
}

/// Whether a message went out in time.
async fn send(socket: &mut WebSocket, message: Message) -> bool {
    let bytes = match &message {
        Message::Binary(bytes) => bytes.len(),
        _ => 0,
    };
    let time = SLOW + Duration::from_secs_f64(bytes as f64 / LEAST_RATE);
    matches!(tokio::time::timeout(time, socket.send(message)).await, Ok(Ok(())))
}

fn say(value: &Value) -> Message {
    Message::Text(value.to_string().into())
}

/// The length of the header in four bytes, little end first, the header as JSON, the picture.
fn answer(shared: &Shared, question: &Question) -> Message {
    let mut renderer = shared.renderer.lock().unwrap_or_else(PoisonError::into_inner);
    let renderer: &mut Renderer = &mut renderer;
    let begun = Instant::now();
    let answer = shared.alone(|| renderer.answer(&shared.stage, question, shared.packing));
    if let Some(pace) = &shared.pace {
        pace.spent(begun.elapsed());
    }
    match answer {
        Ok(answer) => {
            let header = answer.header.to_string().into_bytes();
            let mut bytes = Vec::with_capacity(4 + header.len() + answer.bytes.len());
            bytes.extend((header.len() as u32).to_le_bytes());
            bytes.extend(header);
            bytes.extend(answer.bytes);
            Message::Binary(bytes.into())
        }
        Err(why) => say(&json!({"id": question.id, "error": why})),
    }
}
