//! A page that a server fills: of scenes too large for one HTML file, and with edits that are saved as a file.
//!
//! The page has where all Gaussians are, and then what they look like in blocks. Block k of B has the Gaussians k, k + B, k + 2 B and
//! so on, so each one is spread over the scene, and a few show all of it.

use super::{Viewer, packing, shell};
use crate::error::{Error, Result, ensure};
use crate::files::atomic;
use crate::files::own::{self, Stamp, stamp_of};
use crate::objects::{Editing, Edits, Operation, Regions};
use crate::server::{Server, failed, html, json, typed};
use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, Request, State};
use axum::http::{StatusCode, header};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use rayon::prelude::*;
use serde::Serialize;
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;
use tokio::sync::watch;

/// Bytes of edits at most: all Gaussians of a scene of 10 million, several times over.
const MAX_EDITS: usize = 1 << 28;
/// How often the server checks whether it is to end.
const PAUSE: Duration = Duration::from_millis(50);

/// A page of a scene, its server, and its file of edits.
pub struct Served<'a> {
    /// The content.
    pub viewer: Viewer<'a>,
    /// The file that the page saves edits in, and that it starts from where it is there.
    pub edits: PathBuf,
    /// Gaussians of a block at most.
    pub block: usize,
    /// The address that the server listens on.
    pub listen: IpAddr,
}

/// What the server answers with.
struct Content {
    page: String,
    places: Bytes,
    looks: Vec<Bytes>,
    /// `None` while it is computed.
    tree: watch::Receiver<Option<Bytes>>,
    sha256: String,
    edits: PathBuf,
    saved: Mutex<Saved>,
}

/// The file of edits as it was read or written last.
#[derive(Default, Serialize)]
struct Saved {
    #[serde(rename = "saved")]
    operations: Vec<Operation>,
    /// How often it was written: a page that does not know of the last time must not write.
    saves: usize,
    #[serde(skip)]
    file: Option<Stamp>,
}

impl Content {
    fn saved(&self) -> MutexGuard<'_, Saved> {
        self.saved.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Served<'_> {
    /// Gaussians of a block by default: 8 MB at SH degree 3.
    pub const BLOCK: usize = 100_000;

    /// Serves the page on a free port until `is_over`. `started` gets its address: whoever has it may see the scene
    /// and save edits.
    ///
    /// # Errors
    /// As [`Viewer::page`]; as [`Edits::read`] and [`Edits::apply`] of the file of edits; [`crate::Error::Io`] when no port can be
    /// opened; [`crate::Error::Argument`] for an address that means all interfaces.
    pub fn run(&self, started: impl FnOnce(&str), is_over: impl Fn() -> bool) -> Result<()> {
        let listed = self.viewer.listed()?;
        let gaussians = self.viewer.gaussians;
        let saved = self.saved()?;
        let blocks = gaussians.len().div_ceil(self.block.max(1));
        let mut header = self.viewer.header(&listed);
        header["blocks"] = blocks.into();
        header["edits"] = self.edits.display().to_string().into();
        let looks = (0..blocks).into_par_iter().map(|first| {
            let rows = (first..gaussians.len()).step_by(blocks);
            packing::looks(gaussians, rows).into()
        });
        let (tree, computed) = watch::channel(None);
        let content = Arc::new(Content {
            page: shell(&header, ""),
            places: packing::places(gaussians, &listed.places).into(),
            looks: looks.collect(),
            tree: computed,
            sha256: self.viewer.sha256.to_owned(),
            edits: self.edits.clone(),
            saved: Mutex::new(saved),
        });
        let server = Server::start(self.listen, |token| routes(token, content))?;
        started(server.address());
        thread::scope(|scope| {
            scope.spawn(
                move || match Regions::new(gaussians, self.viewer.features) {
                    Ok(regions) => {
                        tree.send_replace(Some(packing::tree(&regions).into()));
                    }
                    Err(error) => tracing::warn!("the page has no tree of regions: {error}"),
                },
            );
            while !is_over() {
                thread::sleep(PAUSE);
            }
        });
        Ok(())
    }

    /// The edits to start from.
    fn saved(&self) -> Result<Saved> {
        // A later change is noticed before the file is written over.
        own::allow(&self.edits);
        let file = stamp_of(&self.edits);
        if file.is_none() {
            return Ok(Saved::default());
        }
        let edits = Edits::read(&self.edits)?;
        let Viewer {
            labels, classes, ..
        } = self.viewer;
        let gaussians = self.viewer.gaussians;
        ensure!(edits.scene == self.viewer.sha256, &self.edits, "scene"; found "edits of another scene";
            expected "edits of this one, or no file"; help "name another file by --edits, or move this one");
        let unlabelled = || classes.unlabelled(gaussians.len());
        let labels = labels.map_or_else(unlabelled, <[u16]>::to_vec);
        let mut editing = Editing::new(gaussians.clone(), labels, classes.clone());
        edits.apply(&mut editing, self.viewer.sha256, self.viewer.origin)?;
        Ok(Saved {
            operations: edits.operations,
            saves: 0,
            file,
        })
    }
}

fn routes(token: &str, content: Arc<Content>) -> Router {
    Router::new()
        .route(&format!("/{token}/"), get(page))
        .route(&format!("/{token}/places"), get(places))
        .route(&format!("/{token}/looks/{{block}}"), get(looks))
        .route(&format!("/{token}/tree"), get(tree))
        .route(&format!("/{token}/edits"), get(saved))
        .route(&format!("/{token}/edits/{{saves}}"), post(save))
        .layer(DefaultBodyLimit::max(MAX_EDITS))
        .layer(from_fn(bounded))
        .with_state(content)
}

/// Refuses a body whose Content-Length is too large, without reading it.
async fn bounded(request: Request, next: Next) -> Response {
    let length = request.headers().get(header::CONTENT_LENGTH);
    let length = length.and_then(|length| length.to_str().ok()?.parse::<usize>().ok());
    if length.is_some_and(|length| length > MAX_EDITS) {
        let most = MAX_EDITS >> 20;
        let said = format!("the edits have more than {most} MiB");
        return (StatusCode::PAYLOAD_TOO_LARGE, said).into_response();
    }
    next.run(request).await
}

async fn page(State(content): State<Arc<Content>>) -> Response {
    html(content.page.clone())
}

async fn places(State(content): State<Arc<Content>>) -> Response {
    numbers(content.places.clone())
}

async fn looks(State(content): State<Arc<Content>>, Path(block): Path<usize>) -> Response {
    match content.looks.get(block) {
        Some(columns) => numbers(columns.clone()),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

/// Answers when the tree is there.
async fn tree(State(content): State<Arc<Content>>) -> Response {
    let mut tree = content.tree.clone();
    match tree.wait_for(Option::is_some).await.as_deref() {
        Ok(Some(columns)) => numbers(columns.clone()),
        _ => failed("the scene has no tree of regions"),
    }
}

/// What the file of edits has, as far as this server knows.
async fn saved(State(content): State<Arc<Content>>) -> Response {
    json(&*content.saved())
}

/// Writes the file of edits, and answers with the new number of saves. `saves` is the number that the page knows: a page that
/// missed one is refused.
async fn save(
    State(content): State<Arc<Content>>,
    Path(saves): Path<usize>,
    body: String,
) -> Response {
    let path = &content.edits;
    let written = || {
        let edits = Edits::parse(path, &body)?;
        ensure!(edits.scene == content.sha256, path, "scene"; found "edits of another scene";
            expected "edits of the scene that is served"; help "load the page again");
        let mut saved = content.saved();
        ensure!(saves == saved.saves, path, "file"; found "edits that another window has saved since";
            expected "those that this page began with"; help "download these edits, or take the saved ones");
        let there = stamp_of(path);
        ensure!(there.is_none() || there == saved.file, path, "file"; found "a file that another program has changed since";
            expected "the one that the page was saved in or began with"; help "move it away, and save again");
        atomic::write_bytes(path, body.as_bytes())?;
        *saved = Saved {
            operations: edits.operations,
            saves: saves + 1,
            file: stamp_of(path),
        };
        Ok::<_, Error>(saved.saves)
    };
    match written() {
        Ok(saves) => saves.to_string().into_response(),
        Err(error) => (StatusCode::BAD_REQUEST, error.to_string()).into_response(),
    }
}

fn numbers(columns: Bytes) -> Response {
    typed("application/octet-stream", columns)
}
