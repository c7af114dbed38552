//! A server of pages for browsers, on a thread of its own. It listens on one address alone, 127.0.0.1 unless another is asked for. The
//! address of a page has a random token, without which it answers nothing.

use crate::error::{Error, Result, ensure};
use axum::Router;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use rand::TryRngCore;
use rand::rngs::OsRng;
use std::net::{IpAddr, TcpListener};
use std::thread::JoinHandle;
use tokio::sync::oneshot;

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
        // Other pages are told by the address that a browser asks for, so there must be one.
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
            .build()
            .map_err(failed("serve"))?;
        let routes = routes(&token).layer(from_fn_with_state(host, guarded));
        let serve = async move {
            let listener = tokio::net::TcpListener::from_std(listener)?;
            tokio::select! {
                served = axum::serve(listener, routes) => served,
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

/// 128 random bits of the system, in hexadecimal digits.
fn token() -> std::io::Result<String> {
    let mut bytes = [0; 16];
    OsRng
        .try_fill_bytes(&mut bytes)
        .map_err(std::io::Error::other)?;
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
    typed("text/html; charset=utf-8", Body::from(page))
}

/// An answer of a MIME type.
pub(crate) fn typed(kind: &'static str, body: Body) -> Response {
    ([(header::CONTENT_TYPE, kind)], body).into_response()
}

/// An answer that says what went wrong.
pub(crate) fn failed(error: impl std::fmt::Display) -> Response {
    (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response()
}
