//! `gs4d view`: runs and splat files in a browser.

use super::render::load_splat_file;
use crate::answer::Answer;
use crate::device::DeviceFlag;
use crate::failure::{Class, Failure};
use crate::global::{Global, to_stderr};
use crate::opening::RunData;
use crate::{interrupt, parse};
use gs_train::device::Device;
use gs4d_run::Training;
use gs4d_view::{Feed, Options, Packing, REQUEST_TIME, Server, Show, Stage, ViewError, start};
use serde_json::json;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Look at runs and splat files in a browser: orbit, scrub time, compare, pick
#[derive(clap::Args)]
pub struct View {
    /// Run folders, .gs4d files or splat files; the first is shown, the others can be compared with it.
    #[arg(value_name = "RUN|SCENE", required = true)]
    scenes: Vec<PathBuf>,
    #[command(flatten)]
    serving: Serving,
    #[command(flatten)]
    place: RunData,
}

/// Flags of verbs that serve a viewer until they are interrupted.
#[derive(clap::Args)]
pub struct Serving {
    /// Port; if it is taken, one of the next twenty.
    #[arg(long, default_value_t = 7007)]
    port: u16,
    /// Address to listen at. Others than 127.0.0.1 let other machines look, if they know the key.
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    host: IpAddr,
    /// Send JPEG instead of PNG: a tenth of the bytes, for a browser on another machine.
    #[arg(long)]
    remote: bool,
    /// Stop by itself after so many seconds.
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<u64>,
    #[command(flatten)]
    device: DeviceFlag,
}

/// A server and when it ends.
pub struct Served {
    pub server: Server,
    stop: Arc<AtomicBool>,
    until: Option<Instant>,
}

impl Serving {
    /// Starts the server and prints its address.
    pub fn start(&self, shows: Vec<Show>, global: &Global) -> Result<Served, Failure> {
        let device = self.device.open(global)?;
        let packing = if self.remote { Packing::Jpeg } else { Packing::Png };
        let (host, port) = (self.host, self.port);
        let options = Options { host, port, packing, share: None, request_time: REQUEST_TIME, device };
        let server = start(Stage::new(shows), &options)?;
        if !self.host.is_loopback() {
            global.say("warning: other machines can reach this viewer; whoever has the key below sees the scene");
        }
        announce(&server, global);
        global.say("       Ctrl-C ends it");
        let until = self.seconds.and_then(|s| Instant::now().checked_add(Duration::from_secs(s)));
        Ok(Served { server, stop: interrupt::flag()?, until })
    }
}

impl Served {
    /// Whether nobody has ended it and its time is not over.
    pub fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::SeqCst) && self.until.is_none_or(|until| Instant::now() < until)
    }
}

impl View {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let shows = self.scenes.iter().map(|p| self.show(p, global)).collect::<Result<Vec<_>, _>>()?;
        let served = self.serving.start(shows, global)?;
        while served.goes_on() {
            std::thread::sleep(Duration::from_millis(50));
        }
        Ok(Answer::new(String::new(), json!({"url": served.server.url})))
    }

    fn show(&self, path: &Path, global: &Global) -> Result<Show, Failure> {
        let name = name_of(path);
        if path.is_dir() || path.extension().is_some_and(|e| e == "gs4d") {
            let run = self.place.open(path, global)?;
            let dataset = run.open_data();
            if let Err(e) = &dataset {
                global.say(format!("warning: {name} is shown without its images: {e}"));
            }
            return Ok(Show::run(name, run, dataset.ok().as_ref()));
        }
        let (splats, antialiased) = load_splat_file(path, global)?;
        Ok(Show::splats(name, splats).antialiased(antialiased))
    }
}

/// Prints the address, also with `--quiet`: it is the result.
fn announce(server: &Server, global: &Global) {
    to_stderr(format_args!("view   {}", server.url));
    tunnel(server.address).into_iter().for_each(|line| global.say(line));
}

/// How another machine reaches an address by ssh, where that leads to it.
fn tunnel(address: SocketAddr) -> Option<String> {
    let is_reached = address.ip() == Ipv4Addr::LOCALHOST || address.ip().is_unspecified();
    is_reached.then(|| format!("       from another machine: ssh -L {0}:127.0.0.1:{0} THIS_HOST", address.port()))
}

/// Flags of verbs that train: the viewer of the running training.
#[derive(clap::Args)]
pub struct Watch {
    /// Show the run in a browser while it trains. The result stays the same, bit for bit.
    #[arg(long)]
    view: bool,
    /// Port of --view; if it is taken, one of the next twenty.
    #[arg(long, value_name = "PORT", default_value_t = 7007, requires = "view")]
    view_port: u16,
    /// Share of the machine that --view may take from training.
    #[arg(long, value_name = "SHARE", default_value = "10%", value_parser = parse::share, requires = "view")]
    view_share: f64,
}

/// A viewer of a run under training.
pub struct Watched {
    /// Receives the state of the training.
    pub feed: Feed,
    /// Serves until it is dropped.
    _server: Server,
}

impl Watch {
    /// Starts the viewer if asked for; a failure is a warning.
    pub fn start(&self, training: &Training, global: &Global) -> Option<Watched> {
        let begin = || {
            let root = training.folder().root();
            let show = Show::live(name_of(root), training)?;
            let options = Options {
                host: Ipv4Addr::LOCALHOST.into(),
                port: self.view_port,
                packing: Packing::Png,
                share: Some(self.view_share),
                request_time: REQUEST_TIME,
                device: Device::default(),
            };
            let server = start(Stage::new(vec![show]), &options).map_err(|e| e.to_string())?;
            let feed = server
                .feed(gs_methods::registry().clone(), training.trainer().dataset().avatar.clone())
                .map_err(|e| e.to_string())?;
            announce(&server, global);
            Ok(Watched { feed, _server: server })
        };
        let wanted = self.view.then(begin)?;
        wanted.inspect_err(|e: &String| global.say(format!("warning: training goes on without a viewer: {e}"))).ok()
    }
}

/// The last part of a path.
pub fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}

impl From<ViewError> for Failure {
    fn from(e: ViewError) -> Self {
        let text = e.to_string();
        match e {
            ViewError::Port { .. } => {
                Self::new(Class::Io, "view.port", text).remedy("choose another with --port, or end the other viewers")
            }
            ViewError::Device(e) => e.into(),
            ViewError::Threads(_) => Self::new(Class::Resource, "view.threads", text),
            ViewError::Nothing => Self::usage(text),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tunnel_is_named_only_where_it_leads_to_the_viewer() {
        for (address, leads) in [
            ("127.0.0.1:7007", true),
            ("0.0.0.0:7007", true),
            ("[::]:7007", true),
            ("192.168.1.5:7007", false),
            ("127.0.0.2:7007", false),
            ("[::1]:7007", false),
        ] {
            let line = tunnel(address.parse().unwrap());
            assert_eq!(line.is_some_and(|l| l.ends_with("ssh -L 7007:127.0.0.1:7007 THIS_HOST")), leads, "{address}");
        }
    }
}
