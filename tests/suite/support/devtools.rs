//! A browser under remote control: real keys, pointers and reloads, over pipes of Chromium's DevTools protocol.

use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// How long a page may take for what it was asked for.
const PATIENCE: Duration = Duration::from_secs(60);

/// Bits of `modifiers`.
pub const ALT: u32 = 1;
pub const CTRL: u32 = 2;
pub const SHIFT: u32 = 8;

/// A tab with a profile of its own, closed when it is dropped.
pub struct Tab {
    process: Child,
    commands: File,
    answers: BufReader<File>,
    session: Option<String>,
    sent: u64,
    /// Names of events that nobody has waited for, with their content.
    events: Vec<(String, Value)>,
    /// Holds the profile and the pipes.
    _folder: TempDir,
}

/// Another window of a tab's profile.
pub struct Window(Option<String>);

impl Tab {
    /// A tab of this size with the viewer at `path`.
    pub fn open(browser: &str, path: &Path, size: [u32; 2]) -> Self {
        let mut tab = Self::page(browser, path, size);
        tab.expect_ready();
        tab
    }

    /// A tab of this size with the viewer that is served at `url`.
    pub fn served(browser: &str, url: &str, size: [u32; 2]) -> Self {
        let mut tab = Self::visit(browser, url, size);
        tab.expect_ready();
        tab
    }

    /// A tab of this size with the page at `path`.
    pub fn page(browser: &str, path: &Path, size: [u32; 2]) -> Self {
        let url = format!("file://{}", path.canonicalize().unwrap().display());
        Self::visit(browser, &url, size)
    }

    /// A tab of this size with the page at `url`.
    pub fn visit(browser: &str, url: &str, size: [u32; 2]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let pipe = |name: &str| folder.path().join(name);
        let (commands, answers) = (pipe("commands"), pipe("answers"));
        let made = Command::new("mkfifo")
            .args([&commands, &answers])
            .status()
            .unwrap();
        assert!(made.success());
        let process = Command::new("sh")
            .args(["-c", "exec \"$@\" 3<\"$0/commands\" 4>\"$0/answers\""])
            .arg(folder.path())
            .arg(browser)
            .args(["--headless", "--no-sandbox", "--hide-scrollbars"])
            .args(["--enable-unsafe-swiftshader", "--remote-debugging-pipe"])
            .arg(format!(
                "--user-data-dir={}",
                folder.path().join("profile").display()
            ))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut tab = Self {
            process,
            commands: File::options().write(true).open(commands).unwrap(),
            answers: BufReader::new(File::open(answers).unwrap()),
            session: None,
            sent: 0,
            events: Vec::new(),
            _folder: folder,
        };
        let targets = tab.send("Target.getTargets", json!({}));
        let mut targets = targets["targetInfos"].as_array().unwrap().iter();
        let page = &targets.find(|t| t["type"] == "page").unwrap()["targetId"];
        tab.turn_to(page, url, size);
        tab
    }

    /// Turns to another window of the same profile, with the viewer at `url`. [`Tab::swap`] turns back to the window that this returns.
    pub fn window(&mut self, url: &str, size: [u32; 2]) -> Window {
        let first = Window(self.session.take());
        let made = self.send("Target.createTarget", json!({"url": "about:blank"}));
        self.turn_to(&made["targetId"], url, size);
        self.expect_ready();
        first
    }

    /// Turns to the window `other`, which becomes the one that was turned to before.
    pub fn swap(&mut self, other: &mut Window) {
        std::mem::swap(&mut self.session, &mut other.0);
    }

    fn turn_to(&mut self, target: &Value, url: &str, size: [u32; 2]) {
        let attach = json!({"targetId": target, "flatten": true});
        let session = self.send("Target.attachToTarget", attach)["sessionId"].clone();
        self.session = session.as_str().map(str::to_owned);
        self.send("Page.enable", json!({}));
        self.send("Runtime.enable", json!({}));
        self.resize(size, false);
        self.send("Page.navigate", json!({"url": url}));
        self.wait_for("Page.loadEventFired");
    }

    /// Gives the page this size; a phone has a finger instead of a mouse.
    pub fn resize(&mut self, [width, height]: [u32; 2], phone: bool) {
        let size =
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": phone});
        self.send("Emulation.setDeviceMetricsOverride", size);
        self.send(
            "Emulation.setTouchEmulationEnabled",
            json!({"enabled": phone}),
        );
    }

    /// Waits until all of the scene is there.
    fn expect_ready(&mut self) {
        self.until("document.body.dataset.ready === 'yes' || document.getElementById('trouble').textContent !== ''");
        assert_eq!(
            self.value("document.body.dataset.ready"),
            "yes",
            "{}",
            self.value("document.body.innerText")
        );
    }

    /// Loads the page again; a question whether to leave is answered with yes. Returns whether it was asked.
    pub fn reload(&mut self) -> bool {
        self.events.clear();
        self.write("Page.reload", &json!({}));
        let asked = loop {
            self.read();
            let has = |name: &str| self.events.iter().any(|(event, _)| event == name);
            if has("Page.javascriptDialogOpening") {
                break true;
            }
            if has("Page.loadEventFired") {
                break false;
            }
        };
        if asked {
            self.send("Page.handleJavaScriptDialog", json!({"accept": true}));
        }
        self.wait_for("Page.loadEventFired");
        self.expect_ready();
        asked
    }

    /// Sends a command and waits for its result.
    pub fn send(&mut self, method: &str, parameters: Value) -> Value {
        let id = self.write(method, &parameters);
        loop {
            let answer = self.read();
            if answer["id"] == id {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
        }
    }

    fn write(&mut self, method: &str, parameters: &Value) -> u64 {
        self.sent += 1;
        let mut command = json!({"id": self.sent, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            command["sessionId"] = session.as_str().into();
        }
        write!(self.commands, "{command}\0").unwrap();
        self.sent
    }

    fn read(&mut self) -> Value {
        let mut answer = Vec::new();
        self.answers.read_until(0, &mut answer).unwrap();
        assert_eq!(answer.pop(), Some(0), "the browser has ended");
        let answer: Value = serde_json::from_slice(&answer).unwrap();
        if let Some(event) = answer["method"].as_str() {
            let content = answer["params"].clone();
            assert_ne!(event, "Runtime.exceptionThrown", "{content}");
            self.events.push((event.to_owned(), content));
        }
        answer
    }

    fn wait_for(&mut self, event: &str) {
        while !self.events.iter().any(|(name, _)| name == event) {
            self.read();
        }
        self.events.clear();
    }

    /// The value of an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let asked = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let answer = self.send("Runtime.evaluate", asked);
        assert!(
            answer["exceptionDetails"].is_null(),
            "{expression}: {}",
            answer["exceptionDetails"]
        );
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn until(&mut self, expression: &str) {
        let start = Instant::now();
        while self.value(expression) != true {
            assert!(start.elapsed() < PATIENCE, "never true: {expression}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// The value of an expression that is a text.
    pub fn text(&mut self, expression: &str) -> String {
        let value = self.value(expression);
        value.as_str().expect(expression).to_owned()
    }

    /// Presses a key by its code, such as `KeyP`.
    pub fn key(&mut self, code: &str, modifiers: u32) {
        self.hold_key(code, modifiers);
        self.lift_key(code, modifiers);
    }

    /// Presses a key, and keeps it down.
    pub fn hold_key(&mut self, code: &str, modifiers: u32) {
        let mut event = key_event("keyDown", code, modifiers);
        if code == "Enter" {
            event["text"] = "\r".into();
        }
        self.send("Input.dispatchKeyEvent", event);
    }

    /// Lets a key go.
    pub fn lift_key(&mut self, code: &str, modifiers: u32) {
        let event = key_event("keyUp", code, modifiers);
        self.send("Input.dispatchKeyEvent", event);
    }

    /// Types into the element that has the focus.
    pub fn type_text(&mut self, text: &str) {
        self.send("Input.insertText", json!({"text": text}));
    }

    /// Presses, moves and releases the first button along `points`; one point is a click.
    pub fn drag(&mut self, points: &[[f64; 2]], modifiers: u32) {
        self.mouse("mouseMoved", points[0], modifiers, 0);
        self.mouse("mousePressed", points[0], modifiers, 1);
        for &point in &points[1..] {
            self.mouse("mouseMoved", point, modifiers, 1);
        }
        self.mouse("mouseReleased", points[points.len() - 1], modifiers, 0);
    }

    /// Presses the button, as the beginning of a drag.
    pub fn press(&mut self, point: [f64; 2]) {
        self.mouse("mousePressed", point, 0, 1);
    }

    /// Moves the pointer with the button down.
    pub fn pull(&mut self, point: [f64; 2]) {
        self.mouse("mouseMoved", point, 0, 1);
    }

    /// Ends a drag.
    pub fn release(&mut self, point: [f64; 2]) {
        self.mouse("mouseReleased", point, 0, 0);
    }

    /// Moves the pointer.
    pub fn hover(&mut self, point: [f64; 2]) {
        self.mouse("mouseMoved", point, 0, 0);
    }

    /// Puts fingers down, moves them straight from one place to another, and lifts them; where nothing moves it is a tap.
    pub fn fingers<const N: usize>(&mut self, from: [[f64; 2]; N], to: [[f64; 2]; N]) {
        self.touch("touchStart", &from);
        for step in (1..=4).filter(|_| from != to) {
            let part = f64::from(step) / 4.0;
            let at = |i: usize| [0, 1].map(|k| from[i][k] + part * (to[i][k] - from[i][k]));
            self.touch("touchMove", &std::array::from_fn::<_, N, _>(at));
        }
        self.touch("touchEnd", &[]);
    }

    /// An event of all fingers that are down after it.
    pub fn touch(&mut self, kind: &str, points: &[[f64; 2]]) {
        let points = points.iter().enumerate();
        let points: Vec<_> = points
            .map(|(id, [x, y])| json!({"x": x, "y": y, "id": id}))
            .collect();
        self.send(
            "Input.dispatchTouchEvent",
            json!({"type": kind, "touchPoints": points}),
        );
    }

    fn mouse(&mut self, kind: &str, [x, y]: [f64; 2], modifiers: u32, buttons: u32) {
        let button = if kind == "mouseMoved" && buttons == 0 {
            "none"
        } else {
            "left"
        };
        let event = json!({"type": kind, "x": x, "y": y, "button": button, "buttons": buttons,
            "clickCount": 1, "modifiers": modifiers});
        self.send("Input.dispatchMouseEvent", event);
    }
}

/// An event of a key by its code.
fn key_event(kind: &str, code: &str, modifiers: u32) -> Value {
    let key = match code.strip_prefix("Key") {
        Some(letter) if modifiers & SHIFT == 0 => letter.to_lowercase(),
        Some(letter) => letter.to_owned(),
        None if code == "Space" => " ".to_owned(),
        None => code.to_owned(),
    };
    let number = match code {
        "Enter" => 13,
        "Tab" => 9,
        "Space" => 32,
        "Escape" => 27,
        "ArrowLeft" => 37,
        "ArrowUp" => 38,
        "ArrowRight" => 39,
        "ArrowDown" => 40,
        _ => u32::from(key.to_uppercase().as_bytes()[0]),
    };
    json!({"type": kind, "code": code, "key": key, "modifiers": modifiers, "windowsVirtualKeyCode": number})
}

impl Drop for Tab {
    fn drop(&mut self) {
        let closed = json!({"id": 0, "method": "Browser.close"});
        // A browser that has ended already needs no closing.
        if write!(self.commands, "{closed}\0").is_err() {
            let _ = self.process.kill();
        }
        let _ = self.process.wait();
    }
}
