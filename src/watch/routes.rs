//! What the server of a run answers.

use super::{Shared, locked};
use crate::error::Result;
use crate::report::pictures::png;
use crate::server::{failed, html, json, typed};
use axum::Router;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use std::time::Instant;

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

pub(super) fn routes(token: &str, shared: Shared) -> Router {
    Router::new()
        .route(&format!("/{token}/"), get(async || html(PAGE.to_owned())))
        .route(&format!("/{token}/status"), get(status))
        .route(&format!("/{token}/scene.html"), get(scene))
        .route(&format!("/{token}/photo/{{index}}"), get(photo))
        .route(&format!("/{token}/stop"), post(stop))
        .with_state(shared)
}

async fn status(State(shared): State<Shared>) -> Response {
    json(locked(&shared).visit())
}

/// The viewer's page of the last copy of the Gaussians.
async fn scene(State(shared): State<Shared>) -> Response {
    let Some(page) = locked(&shared).page() else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let start = Instant::now();
    let answer = made(page, html).await;
    locked(&shared).rest(start.elapsed());
    answer
}

/// The photo of a view, as PNG.
async fn photo(State(shared): State<Shared>, Path(index): Path<usize>) -> Response {
    let Some(photo) = locked(&shared).photo(index) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let encode = move || png(&*photo.pixels()?, "photo".as_ref());
    made(encode, |bytes| typed("image/png", bytes)).await
}

/// What `answer` makes of the result of long `work`.
async fn made<T: Send + 'static>(
    work: impl FnOnce() -> Result<T> + Send + 'static,
    answer: impl FnOnce(T) -> Response,
) -> Response {
    match tokio::task::spawn_blocking(work).await {
        Ok(Ok(done)) => answer(done),
        Ok(Err(error)) => failed(error),
        Err(error) => failed(error),
    }
}

async fn stop(State(shared): State<Shared>) -> StatusCode {
    locked(&shared).status.stopping = true;
    StatusCode::NO_CONTENT
}
