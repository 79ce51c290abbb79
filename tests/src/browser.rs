//! A headless Chromium, driven over its debugging protocol: a page as a person would use it.
//!
//! The protocol goes through the browser's standard input and output, so that nothing has to be installed beside the
//! browser itself.

use crate::tell;
use base64::Engine;
use serde_json::{Value, json};
use std::collections::{HashMap, HashSet};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// How long the browser may take to answer, and the page to get where it is waited for.
const PATIENCE: Duration = Duration::from_mins(2);
/// How long a page may take to make a file, such as a film whose frames are drawn on a busy machine.
const MAKING: Duration = Duration::from_mins(6);
const PROGRAMS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];

#[derive(Debug)]
pub struct Browser {
    child: Child,
    input: ChildStdin,
    messages: Receiver<Value>,
    session: String,
    last: u64,
    /// What the page complained about: errors on its console, and exceptions.
    pub complaints: Vec<String>,
    /// Files that are on their way here: the browser's number of each, and its name.
    coming: HashMap<String, String>,
    /// Names of files that have come whole.
    whole: HashSet<String>,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Starts it; none where no browser is installed.
    pub fn start() -> Option<Self> {
        let Some(program) = find() else {
            tell("no Chromium on the PATH: its page is not looked at");
            return None;
        };
        let profile = tempfile::tempdir().expect("a temporary folder");
        // The shell gives it the pipes under the numbers that it expects.
        let mut child = Command::new("sh")
            .args(["-c", "exec \"$0\" \"$@\" 3<&0 4>&1 0</dev/null 1>/dev/null 2>/dev/null"])
            .arg(program)
            .args(["--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--disable-gpu", "--no-first-run"])
            .args(["--disable-dev-shm-usage", "--hide-scrollbars", "--disable-background-networking"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a shell");
        let input = child.stdin.take().expect("a pipe");
        let output = BufReader::new(child.stdout.take().expect("a pipe"));
        let (sender, messages) = channel();
        std::thread::spawn(move || {
            for message in output.split(0).map_while(Result::ok) {
                let Ok(message) = serde_json::from_slice(&message) else { continue };
                if sender.send(message).is_err() {
                    return;
                }
            }
        });
        let mut browser = Self {
            child,
            input,
            messages,
            session: String::new(),
            last: 0,
            complaints: Vec::new(),
            coming: HashMap::new(),
            whole: HashSet::new(),
            _profile: profile,
        };
        let target = browser.call("Target.createTarget", &json!({ "url": "about:blank" }))["targetId"].clone();
        let attached = browser.call("Target.attachToTarget", &json!({ "targetId": target, "flatten": true }));
        attached["sessionId"].as_str().expect("a session").clone_into(&mut browser.session);
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            browser.call(domain, &json!({}));
        }
        browser.resize(1280, 900);
        Some(browser)
    }

    fn call(&mut self, method: &str, parameters: &Value) -> Value {
        let mut answer = self.ask(method, parameters);
        assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
        answer["result"].take()
    }

    /// The browser's answer, which has a result or an error.
    fn ask(&mut self, method: &str, parameters: &Value) -> Value {
        self.last += 1;
        let mut call = json!({ "id": self.last, "method": method, "params": parameters });
        if !self.session.is_empty() {
            call["sessionId"] = json!(self.session);
        }
        let mut bytes = call.to_string().into_bytes();
        bytes.push(0);
        self.input.write_all(&bytes).and_then(|()| self.input.flush()).expect("the browser listens");
        let begun = Instant::now();
        loop {
            let left = PATIENCE.saturating_sub(begun.elapsed());
            let message = match self.messages.recv_timeout(left) {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout) => panic!("the browser does not answer {method}"),
                Err(RecvTimeoutError::Disconnected) => panic!("the browser has ended before it answered {method}"),
            };
            if message["id"] == self.last {
                return message;
            }
            self.hear(&message);
        }
    }

    fn hear(&mut self, event: &Value) {
        let parameters = &event["params"];
        let word = |name: &str| parameters[name].as_str().unwrap_or_default().to_owned();
        match event["method"].as_str() {
            Some("Browser.downloadWillBegin") => {
                self.coming.insert(word("guid"), word("suggestedFilename"));
            }
            Some("Browser.downloadProgress") if parameters["state"] == "completed" => {
                self.whole.extend(self.coming.remove(&word("guid")));
            }
            _ => {}
        }
        let complaint = match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => Some(parameters["exceptionDetails"].to_string()),
            Some("Runtime.consoleAPICalled") if parameters["type"] == "error" => Some(parameters["args"].to_string()),
            Some("Log.entryAdded") if parameters["entry"]["level"] == "error" => Some(parameters["entry"].to_string()),
            _ => None,
        };
        self.complaints.extend(complaint);
    }

    /// Files that the page hands over go to this folder from now on.
    pub fn keep_downloads_in(&mut self, folder: &Path) {
        let parameters = json!({ "behavior": "allow", "downloadPath": folder, "eventsEnabled": true });
        // It is the browser that is asked, not its page.
        let session = std::mem::take(&mut self.session);
        self.call("Browser.setDownloadBehavior", &parameters);
        self.session = session;
    }

    /// Clicks an element as a person does, and waits for the file of this name that it leads to.
    pub fn download(&mut self, selector: &str, folder: &Path, name: &str) -> Vec<u8> {
        self.whole.remove(name);
        // Of what no person asked for, a browser takes ten files and no more.
        let click =
            json!({ "expression": format!("document.querySelector({selector:?}).click()"), "userGesture": true });
        let clicked = self.call("Runtime.evaluate", &click);
        assert!(clicked["exceptionDetails"].is_null(), "{selector}: {}", clicked["exceptionDetails"]);
        let begun = Instant::now();
        // A file of this name, empty, is there before it is whole: the browser keeps the name free for itself.
        while !self.whole.contains(name) {
            let text = self.value("document.body?.innerText");
            let text = text.as_str().unwrap_or("");
            assert!(begun.elapsed() <= MAKING, "{name} never came\n{text}\ncomplaints: {:#?}", self.complaints);
            std::thread::sleep(Duration::from_millis(100));
        }
        std::fs::read(folder.join(name)).expect("a readable file")
    }

    pub fn open(&mut self, address: &str) {
        self.call("Page.navigate", &json!({ "url": address }));
    }

    /// The value of an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let mut result = self.call("Runtime.evaluate", &parameters);
        let said: String = expression.chars().take(200).collect();
        assert!(result["exceptionDetails"].is_null(), "{said}: {}", result["exceptionDetails"]);
        result["result"]["value"].take()
    }

    /// Waits until an expression in the page is true.
    pub fn wait_for(&mut self, expression: &str) {
        let begun = Instant::now();
        // While a page loads there is nothing that an expression could be about.
        let probe = format!("(() => {{ try {{ return Boolean({expression}); }} catch {{ return false; }} }})()");
        let evaluated = json!({ "expression": probe, "returnByValue": true });
        // A page that is left meanwhile gives an error, not a value.
        while self.ask("Runtime.evaluate", &evaluated)["result"]["result"]["value"] != true {
            if begun.elapsed() > PATIENCE {
                let text = self.value("document.body?.innerText");
                panic!("never true: {expression}\n{}\ncomplaints: {:#?}", text.as_str().unwrap_or(""), self.complaints);
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Presses and releases a key, e.g. `Tab`, `ArrowRight`, `d`.
    pub fn press(&mut self, key: &str) {
        let mut parameters = json!({ "type": "keyDown", "key": key, "code": key });
        let code = match key {
            "Tab" => 9,
            "Enter" => 13,
            " " => 32,
            "End" => 35,
            "Home" => 36,
            "ArrowLeft" => 37,
            "ArrowUp" => 38,
            "ArrowRight" => 39,
            "ArrowDown" => 40,
            _ => 0,
        };
        parameters["windowsVirtualKeyCode"] = json!(code);
        if key == "Enter" {
            parameters["text"] = json!("\r");
        } else if key.chars().count() == 1 {
            parameters["text"] = json!(key);
        }
        self.call("Input.dispatchKeyEvent", &parameters);
        parameters["type"] = json!("keyUp");
        self.call("Input.dispatchKeyEvent", &parameters);
    }

    /// Drags the mouse over the middle of an element.
    pub fn drag(&mut self, selector: &str, by: (f64, f64)) {
        let middle = self.value(&format!(
            "(() => {{ const element = document.querySelector({selector:?}); element.scrollIntoView({{ block: 'center' }}); \
             const box = element.getBoundingClientRect(); \
             return [box.left + box.width / 2, box.top + box.height / 2]; }})()"
        ));
        let place = |at: usize| middle[at].as_f64().expect("a number");
        let (x, y) = (place(0), place(1));
        let mut mouse = |kind: &str, x: f64, y: f64| {
            let buttons = u8::from(kind != "mouseReleased");
            let parameters =
                json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", &parameters);
        };
        mouse("mousePressed", x, y);
        for step in 1..=6 {
            let share = f64::from(step) / 6.0;
            mouse("mouseMoved", x + by.0 * share, y + by.1 * share);
        }
        mouse("mouseReleased", x + by.0, y + by.1);
    }

    /// Makes the window this large.
    pub fn resize(&mut self, width: u32, height: u32) {
        let parameters = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.call("Emulation.setDeviceMetricsOverride", &parameters);
    }

    /// `light` or `dark`.
    pub fn scheme(&mut self, scheme: &str) {
        let feature = json!({ "name": "prefers-color-scheme", "value": scheme });
        self.call("Emulation.setEmulatedMedia", &json!({ "features": [feature] }));
    }

    /// A picture of what is seen, as PNG.
    pub fn screenshot(&mut self) -> Vec<u8> {
        let taken = self.call("Page.captureScreenshot", &json!({ "format": "png" }));
        base64::prelude::BASE64_STANDARD.decode(taken["data"].as_str().expect("a picture")).expect("base64")
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn find() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    PROGRAMS.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name))).find(|path| path.is_file())
}
