//! A client of the program's servers that says what it likes.

use crate::support::damage::Damage;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Once;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

/// Clients of an attack, at once.
const ATTACKERS: usize = 8;

/// A server, as a client without a browser sees it.
pub struct Client {
    pub host: String,
    /// `/TOKEN/`
    pub root: String,
}

impl Client {
    pub fn at(address: &str) -> Self {
        let rest = address.strip_prefix("http://").unwrap();
        let (host, root) = rest.split_at(rest.find('/').unwrap());
        assert!(host.starts_with("127.0.0."), "{host}");
        assert_eq!(root.len(), 34, "32 hexadecimal digits: {root}");
        Self {
            host: host.to_owned(),
            root: root.to_owned(),
        }
    }

    /// Everything that the server says to `bytes`, after which nothing comes, until it closes the connection.
    ///
    /// # Panics
    /// If it does not.
    pub fn exchange(&self, bytes: &[u8]) -> Vec<u8> {
        let mut stream = TcpStream::connect(&self.host).expect("the server listens");
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        // The server may have closed already.
        let _ = stream.write_all(bytes);
        let _ = stream.shutdown(Shutdown::Write);
        let mut answer = Vec::new();
        if let Err(error) = stream.read_to_end(&mut answer) {
            let hangs = [ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&error.kind());
            assert!(!hangs, "still open after {}", bytes.escape_ascii());
        }
        answer
    }

    /// Sends `count` mutants of `requests`, each kind in turn.
    ///
    /// # Panics
    /// If the server panics at one, or leaves a connection open.
    pub fn attack(&self, requests: &[Vec<u8>], count: usize) {
        let panics = server_panics();
        let mut damage = Damage::new(4);
        let requests = requests.iter().cycle().take(count);
        let mutants: Vec<_> = requests.map(|whole| damage.mutated(whole)).collect();
        thread::scope(|scope| {
            for mutants in mutants.chunks(count.div_ceil(ATTACKERS)) {
                scope.spawn(move || {
                    for bytes in mutants {
                        self.exchange(bytes);
                    }
                });
            }
        });
        assert_eq!(server_panics(), panics, "a thread of a server has panicked");
    }

    /// A request at an address below the root, with more header lines and a body.
    pub fn message(&self, method: &str, what: &str, more: &str, body: &[u8]) -> Vec<u8> {
        let Self { host, root } = self;
        let head = format!(
            "{method} {root}{what} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n"
        );
        [head.as_bytes(), body].concat()
    }

    /// Status, head and body of the answer to `method path` with more header lines.
    pub fn ask(&self, method: &str, path: &str, host: &str, more: &str) -> (u16, String, Vec<u8>) {
        let request =
            format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n");
        self.request(request.as_bytes())
    }

    /// Status and body of the answer to `body` at an address below the root, with more header lines.
    pub fn post(&self, what: &str, body: &str, more: &str) -> (u16, Vec<u8>) {
        let more = format!("Content-Length: {}\r\n{more}", body.len());
        let request = self.message("POST", what, &more, body.as_bytes());
        let (status, _, body) = self.request(&request);
        (status, body)
    }

    /// Status, head and body of the answer to a request after which the connection stays open.
    pub fn request(&self, request: &[u8]) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.host).expect("the server listens");
        stream.write_all(request).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(answer[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, head, answer[end + 4..].to_vec())
    }

    /// Status and body of an address below the root, with the headers that all answers have.
    pub fn get(&self, what: &str) -> (u16, Vec<u8>) {
        let path = format!("{}{what}", self.root);
        let (status, head, body) = self.ask("GET", &path, &self.host, "");
        assert!(head.contains("frame-ancestors 'self'"), "{head}");
        assert!(head.contains("no-store"), "{head}");
        (status, body)
    }
}

/// How often threads of servers have panicked. Tokio catches that, and no test fails by itself.
fn server_panics() -> usize {
    static PANICS: AtomicUsize = AtomicUsize::new(0);
    static COUNTED: Once = Once::new();
    COUNTED.call_once(|| {
        let report = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if thread::current().name() == Some("server") {
                PANICS.fetch_add(1, Ordering::Relaxed);
            }
            report(info);
        }));
    });
    PANICS.load(Ordering::Relaxed)
}
