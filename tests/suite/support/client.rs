//! A client of the program's servers that says what it likes.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

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

    /// Everything that the server says to `bytes`, until it closes the connection or is silent for a while.
    pub fn exchange(&self, bytes: &[u8]) -> Vec<u8> {
        let mut stream = TcpStream::connect(&self.host).expect("the server listens");
        stream
            .set_read_timeout(Some(Duration::from_millis(300)))
            .unwrap();
        // The server may have closed already.
        let _ = stream.write_all(bytes);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    /// Status and body of `method path` with more header lines.
    pub fn ask(&self, method: &str, path: &str, host: &str, more: &str) -> (u16, String, Vec<u8>) {
        self.request(&format!(
            "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n"
        ))
    }

    /// Status and body of the answer to `body` at an address below the root, with more header lines.
    pub fn post(&self, what: &str, body: &str, more: &str) -> (u16, Vec<u8>) {
        let Self { host, root } = self;
        let length = body.len();
        let head = format!("POST {root}{what} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n");
        let request = format!("{head}Content-Length: {length}\r\n{more}\r\n{body}");
        let (status, _, body) = self.request(&request);
        (status, body)
    }

    fn request(&self, request: &str) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.host).expect("the server listens");
        stream.write_all(request.as_bytes()).unwrap();
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
