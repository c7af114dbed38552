//! A server of pages for browsers, on a thread of its own. It listens on one address alone, 127.0.0.1 unless another is asked for. The
//! address of a page has a random token, without which it answers nothing.

use crate::error::{Error, Result, ensure};
use axum::Router;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rand::TryRngCore;
use rand::rngs::OsRng;
use serde::Serialize;
use std::convert::Infallible;
use std::io;
use std::net::{IpAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::{Semaphore, oneshot};

/// Connections at a time. Further clients wait in the queue of the system, and use none of the open files that a run needs.
const CONNECTIONS: usize = 64;
/// A connection is closed when the head of a request has not come, or not whole, for this long.
const SILENCE: Duration = Duration::from_secs(30);
/// How long to wait after a connection that could not be accepted.
const PAUSE: Duration = Duration::from_millis(100);

/// Sent with every answer: nothing is kept, framed, or loaded from elsewhere.
const HEADERS: [(HeaderName, &str); 4] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; \
         frame-src 'self'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'",
    ),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::CACHE_CONTROL, "no-store"),
];

/// Answers browsers until it is dropped.
pub(crate) struct Server {
    address: String,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves `routes`, which all begin with `/TOKEN/`, on a free port of `listen`.
    ///
    /// # Errors
    /// [`Error::Argument`] for an address that means all interfaces; [`Error::Io`] when no port can be opened.
    pub fn start(listen: IpAddr, routes: impl FnOnce(&str) -> Router) -> Result<Self> {
        Self::with_silence(listen, SILENCE, routes)
    }

    /// The same, with another time after which a silent connection is closed.
    fn with_silence(
        listen: IpAddr,
        silence: Duration,
        routes: impl FnOnce(&str) -> Router,
    ) -> Result<Self> {
        // Requests of other pages are recognised by the address that they ask for, so there must be one address.
        ensure!(!listen.is_unspecified(), argument "--listen"; found "{listen}, all interfaces";
            expected "the address of one interface of this machine"; help "`ip address` lists them; 127.0.0.1 is this machine alone");
        let failed = |action| move |e| Error::io(listen.to_string(), action, e);
        let open = || {
            let listener = TcpListener::bind((listen, 0))?;
            listener.set_nonblocking(true)?;
            Ok((listener.local_addr()?.to_string(), listener))
        };
        let (host, listener) = open().map_err(failed("open a port of"))?;
        let token = token().map_err(failed("draw a token for"))?;
        let address = format!("http://{host}/{token}/");
        let (end, ended) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(1)
            .thread_name("server")
            .build()
            .map_err(failed("serve"))?;
        let routes = routes(&token).layer(from_fn_with_state(host, guarded));
        let serve = async move {
            tokio::select! {
                failed = serve(listener, routes, silence) => failed.map(|never| match never {}),
                _ = ended => Ok(()),
            }
        };
        let thread = std::thread::Builder::new().name("server".to_owned());
        let thread = thread.spawn(move || {
            if let Err(error) = runtime.block_on(serve) {
                tracing::warn!("the page is no longer served: {error}");
            }
            runtime.shutdown_background();
        });
        Ok(Self {
            address,
            end: Some(end),
            thread: Some(thread.map_err(failed("serve"))?),
        })
    }

    /// The page, with its token.
    pub fn address(&self) -> &str {
        &self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // An error means that the thread has ended.
        let _ = self.end.take().map(|end| end.send(()));
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Answers connections. A client that leaves in the middle of an answer harms nobody.
async fn serve(listener: TcpListener, routes: Router, silence: Duration) -> io::Result<Infallible> {
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let free = Arc::new(Semaphore::new(CONNECTIONS));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(silence);
    loop {
        let permit = free.clone().acquire_owned().await;
        let permit = permit.map_err(io::Error::other)?;
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!("a connection was not accepted: {error}");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        let routes = TowerToHyperService::new(routes.clone());
        let connection = http.serve_connection(TokioIo::new(stream), routes);
        tokio::spawn(async move {
            let _ = connection.await;
            drop(permit);
        });
    }
}

/// 128 random bits of the system, in hexadecimal digits.
fn token() -> io::Result<String> {
    let mut bytes = [0; 16];
    OsRng.try_fill_bytes(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Refuses pages of other origins, and names of other hosts that lead here (DNS rebinding).
async fn guarded(State(host): State<String>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let is_host = headers.get(header::HOST).is_some_and(|h| *h == *host);
    let own = format!("http://{host}");
    let is_own = headers.get(header::ORIGIN).is_none_or(|o| *o == *own);
    let mut response = if is_host && is_own {
        next.run(request).await
    } else {
        StatusCode::FORBIDDEN.into_response()
    };
    for (name, value) in HEADERS {
        let value = HeaderValue::from_static(value);
        response.headers_mut().insert(name, value);
    }
    response
}

/// An answer that is a page.
pub(crate) fn html(page: String) -> Response {
    typed("text/html; charset=utf-8", page)
}

/// An answer of a MIME type.
pub(crate) fn typed(kind: &'static str, body: impl Into<Body>) -> Response {
    ([(header::CONTENT_TYPE, kind)], body.into()).into_response()
}

/// An answer that is `value` as JSON.
pub(crate) fn json(value: &impl Serialize) -> Response {
    match serde_json::to_string(value) {
        Ok(text) => typed("application/json", text),
        Err(error) => failed(error),
    }
}

/// An answer that says what went wrong.
pub(crate) fn failed(error: impl std::fmt::Display) -> Response {
    (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::routing::get;
    use std::io::{Read, Write};
    use std::net::{Ipv4Addr, TcpStream};

    #[test]
    fn idle_connections_are_closed_for_others() {
        let silence = Duration::from_millis(300);
        let routes = |token: &str| Router::new().route(&format!("/{token}/"), get(async || "here"));
        let server = Server::with_silence(Ipv4Addr::LOCALHOST.into(), silence, routes).unwrap();
        let rest = server.address().strip_prefix("http://").unwrap();
        let (host, root) = rest.split_at(rest.find('/').unwrap());
        let connection = || {
            let stream = TcpStream::connect(host).unwrap();
            let patience = Some(Duration::from_secs(30));
            stream.set_read_timeout(patience).unwrap();
            stream
        };
        let answer = |stream: &mut TcpStream| {
            let mut answer = String::new();
            stream.read_to_string(&mut answer).expect("it is closed");
            answer
        };
        // Most say nothing, some half of a request.
        let mut idle: Vec<TcpStream> = (0..CONNECTIONS + 20).map(|_| connection()).collect();
        for stream in idle.iter_mut().step_by(9) {
            stream.write_all(b"GET / HTTP/1.1\r\nHo").unwrap();
        }
        let mut stream = connection();
        let request = format!("GET {root} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let said = answer(&mut stream);
        assert!(
            said.starts_with("HTTP/1.1 200") && said.ends_with("here"),
            "{said}"
        );
        for mut stream in idle {
            assert!(!answer(&mut stream).contains("here"));
        }
    }
}
