//! The server: its threads, its address, and what all connections share.

use crate::ViewError;
use crate::guard::Guard;
use crate::live::{Feed, Pace, THREAD_NAME};
use crate::outbox::Outbox;
use crate::packing::Packing;
use crate::picture::Renderer;
use crate::scene::{LiveFrame, Scene};
use crate::stage::Stage;
use crate::turns::Turns;
use crate::{requests, routes};
use gs_core::Splats;
use gs_data::avatar::AvatarScene;
use gs_train::device::Device;
use gs_train::registry::Registry;
use serde_json::{Value, json};
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{Mutex, oneshot, watch};

/// Ports tried after the one asked for.
const EXTRA_PORTS: u16 = 20;
/// Default of [`Options::request_time`].
pub const REQUEST_TIME: Duration = Duration::from_secs(10);

/// Where the server listens and how much of the machine it uses.
#[derive(Clone, Debug)]
pub struct Options {
    /// Address to listen at; loopback unless other machines are to connect.
    pub host: IpAddr,
    /// First port tried; the next 20 follow.
    pub port: u16,
    /// Format of the images sent.
    pub packing: Packing,
    /// Share of the machine for rendering, on one thread; `None`: all threads without limit.
    pub share: Option<f64>,
    /// How long a connection may last that is no WebSocket: a request that is not complete by then is not answered.
    pub request_time: Duration,
    /// What renders the images.
    pub device: Device,
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

    /// Shows a frame of a live film in the first show. Pages ask for it; with its image they get the time since `written`, when
    /// its last file was written.
    pub fn show_frame(&self, splats: Splats, number: u32, written: Instant) {
        let news = json!({"frame": {"number": number, "splats": splats.len()}});
        self.shared.stage.shows()[0].replace(Scene::live(splats, LiveFrame { number, written }));
        *self.shared.last_news.lock().unwrap_or_else(PoisonError::into_inner) = Some(news);
        self.shared.tell();
    }

    /// Bytes of answers that wait for browsers to read them: at most 64 MiB of images and as many of splats, or one answer of each.
    pub fn queued_bytes(&self) -> usize {
        self.shared.outbox.bytes()
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
    pub(crate) guard: Guard,
    pub(crate) packing: Packing,
    pub(crate) renderer: Mutex<Renderer>,
    device: Device,
    pub(crate) turns: Arc<Turns>,
    pub(crate) outbox: Arc<Outbox>,
    /// Connected browsers.
    pub(crate) clients: AtomicUsize,
    /// Newest message to all browsers.
    pub(crate) news: watch::Sender<Option<String>>,
    /// Newest list of all shows, sent when one is added. Not among [`Self::news`], of which a page that is slow to read gets the newest alone.
    pub(crate) listed: watch::Sender<String>,
    /// Held by the request whose file is taken.
    pub(crate) uploads: Mutex<()>,
    /// Newest state of a training, for pages that open later.
    pub(crate) last_news: std::sync::Mutex<Option<Value>>,
    /// Whether a page has asked the training to pause.
    pub(crate) paused: AtomicBool,
    /// Half of [`Options::share`].
    half_share: Option<f64>,
    pub(crate) pace: Option<Pace>,
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
            renderer: Mutex::new(Renderer::on(&options.device)?),
            device: options.device.clone(),
            turns: Arc::default(),
            outbox: Arc::default(),
            clients: AtomicUsize::new(0),
            news: watch::Sender::new(None),
            listed: watch::Sender::new(String::new()),
            uploads: Mutex::default(),
            last_news: std::sync::Mutex::default(),
            paused: AtomicBool::new(false),
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

    /// Pauses the training or lets it go on, and tells every page.
    pub(crate) fn pause(&self, paused: bool) {
        self.paused.store(paused, Ordering::SeqCst);
        self.tell();
    }

    /// The newest state of a training, and whether it is paused; empty without one.
    pub(crate) fn training(&self) -> Value {
        let news = self.last_news.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut all = json!({"paused": self.paused.load(Ordering::SeqCst)});
        if let Some(news) = news {
            all["news"] = news;
        }
        all
    }

    /// Sends [`Self::training`] to every page.
    pub(crate) fn tell(&self) {
        self.news.send_replace(Some(self.training().to_string()));
    }

    /// Frees the buffers of the renderer if no browser is connected.
    pub(crate) fn release_buffers(&self) {
        if self.clients.load(Ordering::SeqCst) == 0
            && let Ok(mut renderer) = self.renderer.try_lock()
            && let Ok(empty) = Renderer::on(&self.device)
        {
            *renderer = empty;
        }
    }
}

/// Starts a server in its own threads.
///
/// # Errors
/// If there is no show, no free port, threads cannot be started, or the device fails.
///
/// ```
/// use gs4d_view::{Options, Packing, REQUEST_TIME, Show, Stage, start};
/// let stage = Stage::new(vec![Show::splats("empty".into(), gs_core::Splats::default())]);
/// let (host, packing) = ([127, 0, 0, 1].into(), Packing::Png);
/// let device = gs_train::device::Device::default();
/// let options = Options { host, port: 18_900, packing, share: None, request_time: REQUEST_TIME, device };
/// let server = start(stage, &options)?;
/// assert!(server.url.starts_with("http://127.0.0.1:189") && server.url.contains("/?k="));
/// # Ok::<(), gs4d_view::ViewError>(())
/// ```
pub fn start(stage: Stage, options: &Options) -> Result<Server, ViewError> {
    if stage.shows().is_empty() {
        return Err(ViewError::Nothing);
    }
    let listener = listen(options.host, options.port)?;
    let address = listener.local_addr().map_err(ViewError::Threads)?;
    let guard = Guard::new(address);
    let url = format!("http://{address}/?k={}", guard.token());
    let shared = Arc::new(Shared::new(stage, guard, options)?);
    let (kept, limit) = (shared.clone(), options.request_time);
    let mut runtime = tokio::runtime::Builder::new_multi_thread();
    let runtime = runtime.worker_threads(2).thread_name(THREAD_NAME).enable_all().build();
    let runtime = runtime.map_err(ViewError::Threads)?;
    let (stop, stopped) = oneshot::channel();
    let thread = std::thread::Builder::new().name(THREAD_NAME.into()).spawn(move || {
        runtime.block_on(async {
            let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
            tokio::select! {
                () = requests::serve(listener, routes::routes(kept), limit) => {}
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
