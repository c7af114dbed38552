//! The server of [`Watched`](super::Watched), on a thread of its own.

use super::{Shared, locked};
use crate::error::{Error, Result};
use axum::Router;
use axum::body::Body;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use image::ImageFormat;
use rand::TryRngCore;
use rand::rngs::OsRng;
use std::io::Cursor;
use std::net::{Ipv4Addr, TcpListener};
use std::thread::JoinHandle;
use std::time::Instant;
use tokio::sync::oneshot;

const PAGE: &str = concat!(
    include_str!("page/head.html"),
    "<style>\n",
    include_str!("page/watch.css"),
    "</style>\n",
    include_str!("page/body.html"),
    "<script type=\"module\">\n",
    include_str!("page/chart.js"),
    include_str!("page/watch.js"),
    "</script>\n</body>\n</html>\n"
);

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
pub(super) struct Server {
    address: String,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens on a free port of 127.0.0.1.
    pub fn start(shared: Shared) -> Result<Self> {
        let failed = |action| move |e| Error::io("127.0.0.1", action, e);
        let listener =
            TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(failed("open a port of"))?;
        listener
            .set_nonblocking(true)
            .map_err(failed("open a port of"))?;
        let host = listener
            .local_addr()
            .map_err(failed("open a port of"))?
            .to_string();
        let token = token().map_err(failed("draw a token for"))?;
        let address = format!("http://{host}/{token}/");
        let (end, ended) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(1)
            .build()
            .map_err(failed("serve"))?;
        let routes = routes(&token, shared).layer(from_fn_with_state(host, guarded));
        let serve = async move {
            let listener = tokio::net::TcpListener::from_std(listener)?;
            tokio::select! {
                served = axum::serve(listener, routes) => served,
                _ = ended => Ok(()),
            }
        };
        let thread = std::thread::Builder::new().name("watch".to_owned());
        let thread = thread.spawn(move || {
            if let Err(error) = runtime.block_on(serve) {
                tracing::warn!("the page of the run is no longer served: {error}");
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

fn routes(token: &str, shared: Shared) -> Router {
    Router::new()
        .route(&format!("/{token}/"), get(async || html(PAGE.to_owned())))
        .route(&format!("/{token}/status"), get(status))
        .route(&format!("/{token}/scene.html"), get(scene))
        .route(&format!("/{token}/photo/{{index}}"), get(photo))
        .route(&format!("/{token}/stop"), post(stop))
        .with_state(shared)
}

/// Refuses pages of other origins, and names of other hosts that lead here (DNS rebinding).
async fn guarded(State(host): State<String>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let is_host = headers.get(header::HOST).is_some_and(|h| *h == *host);
    let is_own = is_own_origin(headers, &host);
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

fn is_own_origin(headers: &HeaderMap, host: &str) -> bool {
    let own = format!("http://{host}");
    headers.get(header::ORIGIN).is_none_or(|o| *o == *own)
}

async fn status(State(shared): State<Shared>) -> Response {
    let text = serde_json::to_string(locked(&shared).visit());
    match text {
        Ok(text) => typed("application/json", Body::from(text)),
        Err(error) => failed(error),
    }
}

/// The viewer's page of the last copy of the Gaussians.
async fn scene(State(shared): State<Shared>) -> Response {
    let Some(page) = locked(&shared).page() else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let start = Instant::now();
    let made = tokio::task::spawn_blocking(page).await;
    locked(&shared).rest(start.elapsed());
    match made {
        Ok(Ok(page)) => html(page),
        Ok(Err(error)) => failed(error),
        Err(error) => failed(error),
    }
}

/// The photo of a view, as PNG.
async fn photo(State(shared): State<Shared>, Path(index): Path<usize>) -> Response {
    let Some(photo) = locked(&shared).photo(index) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let encode = move || {
        let mut bytes = Cursor::new(Vec::new());
        let pixels = photo.pixels()?;
        let written = pixels.write_to(&mut bytes, ImageFormat::Png);
        written.map_err(|e| Error::io("photo", "encode", std::io::Error::other(e)))?;
        Ok::<_, Error>(bytes.into_inner())
    };
    match tokio::task::spawn_blocking(encode).await {
        Ok(Ok(bytes)) => typed("image/png", Body::from(bytes)),
        Ok(Err(error)) => failed(error),
        Err(error) => failed(error),
    }
}

async fn stop(State(shared): State<Shared>) -> StatusCode {
    locked(&shared).status.stopping = true;
    StatusCode::NO_CONTENT
}

fn html(page: String) -> Response {
    typed("text/html; charset=utf-8", Body::from(page))
}

fn typed(kind: &'static str, body: Body) -> Response {
    ([(header::CONTENT_TYPE, kind)], body).into_response()
}

fn failed(error: impl std::fmt::Display) -> Response {
    (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response()
}
