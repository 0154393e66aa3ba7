//! Chromium without a window, by its DevTools protocol.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket};

/// How long a page may take for anything.
const PATIENCE: Duration = Duration::from_secs(60);

/// A browser with one page.
pub struct Chromium {
    child: Child,
    socket: WebSocket<TcpStream>,
    session: String,
    calls: u64,
    /// Errors of the page: exceptions, and what it wrote to the console as one.
    pub complaints: Vec<String>,
    profile: TempDir,
}

impl Drop for Chromium {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The program, if there is one.
pub fn find() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let places = std::env::split_paths(&path).flat_map(|p| ["chromium", "chromium-browser"].map(|n| p.join(n)));
    places.into_iter().find(|p| p.is_file())
}

impl Chromium {
    /// Starts it at a window of 1000×800.
    pub fn start(program: &Path) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let mut child = Command::new(program)
            .args([
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--enable-unsafe-swiftshader",
                "--remote-debugging-port=0",
            ])
            .args(["--window-size=1000,800", "--no-first-run", "--disable-background-networking"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let found =
            |l: std::io::Result<String>| l.ok()?.split_once("listening on ").map(|(_, url)| url.trim().to_owned());
        let url = lines.into_iter().find_map(found).expect("chromium tells its address");
        let host = url.strip_prefix("ws://").unwrap().split('/').next().unwrap();
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let config = tungstenite::protocol::WebSocketConfig::default().max_message_size(None).max_frame_size(None);
        let (socket, _) = tungstenite::client::client_with_config(url.as_str(), stream, Some(config)).unwrap();
        let (session, complaints) = (String::new(), Vec::new());
        let mut browser = Self { child, socket, session, calls: 0, complaints, profile };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}))["targetId"].clone();
        let attached = browser.call("Target.attachToTarget", json!({"targetId": target, "flatten": true}));
        browser.session = attached["sessionId"].as_str().unwrap().to_owned();
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            browser.call(domain, json!({}));
        }
        let folder = browser.downloads();
        browser.call("Page.setDownloadBehavior", json!({"behavior": "allow", "downloadPath": folder}));
        browser
    }

    /// Where files go that the page saves.
    fn downloads(&self) -> PathBuf {
        self.profile.path().join("downloads")
    }

    /// The saved file whose name ends so.
    pub fn downloaded(&self, ending: &str) -> PathBuf {
        let begun = Instant::now();
        loop {
            let files = std::fs::read_dir(self.downloads()).into_iter().flatten().flatten();
            let found = files.map(|f| f.path()).find(|p| p.to_string_lossy().ends_with(ending));
            if let Some(file) = found {
                return file;
            }
            assert!(begun.elapsed() < PATIENCE, "nothing that ends in {ending} was saved");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn call(&mut self, method: &str, params: Value) -> Value {
        self.calls += 1;
        let mut call = json!({"id": self.calls, "method": method, "params": params});
        if !self.session.is_empty() {
            call["sessionId"] = json!(self.session);
        }
        self.socket.send(Message::Text(call.to_string().into())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let said: Value = serde_json::from_str(&text).unwrap();
            if said["id"] == self.calls {
                assert!(said["error"].is_null(), "{method}: {}", said["error"]);
                return said["result"].clone();
            }
            self.listen(&said);
        }
    }

    fn listen(&mut self, said: &Value) {
        let params = &said["params"];
        let bad = match said["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Runtime.consoleAPICalled") => params["type"] == "error",
            Some("Log.entryAdded") => params["entry"]["level"] == "error",
            _ => false,
        };
        if bad {
            self.complaints.push(params.to_string());
        }
    }

    /// Opens a page.
    pub fn open(&mut self, url: &str) {
        self.leave();
        self.call("Page.navigate", json!({"url": url}));
    }

    /// Leaves the page.
    pub fn leave(&mut self) {
        self.call("Page.navigate", json!({"url": "about:blank"}));
    }

    /// The size of the window, pixels of the page.
    pub fn resize(&mut self, width: u32, height: u32) {
        let size = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500});
        self.call("Emulation.setDeviceMetricsOverride", size);
    }

    /// What an expression of the page gives.
    pub fn eval(&mut self, expression: &str) -> Value {
        let asked = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let said = self.call("Runtime.evaluate", asked);
        assert!(said["exceptionDetails"].is_null(), "{expression}: {said}");
        said["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn until(&mut self, expression: &str) {
        let begun = Instant::now();
        while self.eval(&format!("!!({expression})")) != true {
            if begun.elapsed() > PATIENCE {
                let state = "JSON.stringify([document.body?.dataset, document.body?.innerText.slice(0, 300)])";
                let state = self.eval(state);
                panic!("never true: {expression}; the page: {state}; {:?}", self.complaints);
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Presses the mouse at the first place and lets go at the last.
    pub fn drag(&mut self, places: &[[f64; 2]]) {
        let (first, last) = (places[0], places[places.len() - 1]);
        let mut mouse = |kind: &str, [x, y]: [f64; 2], buttons: u32| {
            self.call(
                "Input.dispatchMouseEvent",
                json!({"type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1}),
            );
        };
        mouse("mouseMoved", first, 0);
        mouse("mousePressed", first, 1);
        places.iter().skip(1).for_each(|p| mouse("mouseMoved", *p, 1));
        mouse("mouseReleased", last, 0);
    }

    /// Moves two fingers, each from its first place to its second.
    pub fn pinch(&mut self, fingers: [[[f64; 2]; 2]; 2]) {
        let mut touch = |kind: &str, share: Option<f64>| {
            let place = |f: usize, s: f64| [0, 1].map(|c| fingers[f][0][c] + s * (fingers[f][1][c] - fingers[f][0][c]));
            let point = |f: usize, s: f64| json!({"id": f, "x": place(f, s)[0], "y": place(f, s)[1]});
            let points: Vec<Value> = share.map(|s| (0..2).map(|f| point(f, s)).collect()).unwrap_or_default();
            self.call("Input.dispatchTouchEvent", json!({"type": kind, "touchPoints": points}));
        };
        touch("touchStart", Some(0.0));
        (1..=5).for_each(|k| touch("touchMove", Some(0.2 * f64::from(k))));
        touch("touchEnd", None);
    }

    /// Makes the system prefer a colour scheme.
    pub fn prefer(&mut self, scheme: &str) {
        let feature = json!([{"name": "prefers-color-scheme", "value": scheme}]);
        self.call("Emulation.setEmulatedMedia", json!({"features": feature}));
    }

    /// The middle of an element.
    pub fn middle(&mut self, id: &str) -> [f64; 2] {
        let at = self.eval(&format!(
            "(() => {{ const e = document.getElementById('{id}'); e.scrollIntoViewIfNeeded(); \
             const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
        ));
        [0, 1].map(|k| at[k].as_f64().unwrap())
    }

    /// Clicks the middle of an element.
    pub fn click(&mut self, id: &str) {
        let at = self.middle(id);
        self.drag(&[at]);
    }

    /// Presses a key where the focus is.
    pub fn key(&mut self, key: &str) {
        let text = if key.chars().count() == 1 { key } else { "" };
        for kind in ["keyDown", "keyUp"] {
            let pressed = json!({"type": kind, "key": key, "text": if kind == "keyDown" { text } else { "" }});
            self.call("Input.dispatchKeyEvent", pressed);
        }
    }

    /// Chooses a value of a list, or moves a slider.
    pub fn set(&mut self, id: &str, value: &str) {
        let events = "e.dispatchEvent(new Event('input')); e.dispatchEvent(new Event('change'));";
        self.eval(&format!("{{ const e = document.getElementById('{id}'); e.value = '{value}'; {events} }}"));
    }

    /// Saves what the window shows.
    pub fn shot(&mut self, file: &Path) {
        let data = self.call("Page.captureScreenshot", json!({"format": "png"}));
        std::fs::write(file, base64(data["data"].as_str().unwrap())).unwrap();
    }
}

/// The bytes of a base64 text.
pub fn base64(text: &str) -> Vec<u8> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u8> = text.bytes().filter(|c| *c != b'=').map(value).collect();
    let bytes = |four: &[u8]| {
        let bits = four.iter().enumerate().fold(0u32, |sum, (k, d)| sum | u32::from(*d) << (18 - 6 * k));
        (0..four.len() - 1).map(move |k| (bits >> (16 - 8 * k)) as u8).collect::<Vec<u8>>()
    };
    digits.chunks(4).flat_map(bytes).collect()
}
