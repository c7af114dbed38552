//! A run that browsers can watch: its figures, its curves, and its Gaussians as they are.
//!
//! [`Watched`] listens to a run in place of another [`Progress`], which it keeps informed. A server thread answers browsers from a
//! copy of what `Watched` has heard, so no browser can hold the run up. Its address has a random token, without which it answers
//! nothing.

mod routes;
mod run_state;

use self::routes::routes;
use self::run_state::{RunState, SceneCopy};
use crate::data::Scene;
use crate::error::Result;
use crate::progress::{Event, Progress};
use crate::server::Server;
use crate::splat::Gaussians;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How long the end of a run waits for a browser that is there: it asks every second.
const FAREWELL: Duration = Duration::from_millis(1_500);

/// What the run and the server share.
type Shared = Arc<Mutex<RunState>>;

/// Passes all events of a run on to a listener, and shows the run to browsers.
pub struct Watched<P> {
    listener: P,
    shared: Shared,
    server: Server,
    /// When the run began to read Gaussians for a copy from its device.
    reading: Option<Instant>,
}

impl<P: Progress> Watched<P> {
    /// Starts the server of a run called `title`, on a free port of `listen`. `alpha_max` is the run's cap of a splat's opacity. All events
    /// reach `listener` too.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when no port can be opened; [`crate::Error::Argument`] for an address that means all interfaces.
    pub fn start(listen: IpAddr, title: &str, alpha_max: f64, listener: P) -> Result<Self> {
        let shared = Arc::new(Mutex::new(RunState::new(title, alpha_max)));
        let server = Server::start(listen, |token| routes(token, shared.clone()))?;
        Ok(Self {
            listener,
            shared,
            server,
            reading: None,
        })
    }

    /// The page for a browser. Whoever has this address may watch and stop the run.
    pub fn address(&self) -> &str {
        self.server.address()
    }
}

impl<P> Drop for Watched<P> {
    /// A browser that is there gets the last figures.
    fn drop(&mut self) {
        locked(&self.shared).status.ended = true;
        let start = Instant::now();
        while start.elapsed() < FAREWELL && locked(&self.shared).awaits_visit() {
            std::thread::sleep(FAREWELL / 30);
        }
    }
}

/// The state. It stays usable after a panic in the other thread, because no field is ever half written.
fn locked(shared: &Shared) -> MutexGuard<'_, RunState> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<P: Progress> Progress for Watched<P> {
    fn event(&mut self, event: &Event) {
        locked(&self.shared).record(event);
        self.listener.event(event);
    }

    fn stop(&mut self) -> bool {
        let requested = locked(&self.shared).status.stopping;
        self.listener.stop() || requested
    }

    fn scene(&mut self, scene: &Scene) {
        locked(&self.shared).set_scene(scene);
        self.listener.scene(scene);
    }

    fn wants_gaussians(&mut self) -> bool {
        let wanted = locked(&self.shared).wants_gaussians();
        self.reading = wanted.then(Instant::now);
        self.listener.wants_gaussians() || wanted
    }

    fn gaussians(&mut self, gaussians: &Gaussians, labels: Option<&[u16]>) {
        let start = self.reading.take().unwrap_or_else(Instant::now);
        let copy = SceneCopy::new(gaussians, labels);
        let mut state = locked(&self.shared);
        state.set_copy(copy);
        state.rest(start.elapsed());
        drop(state);
        self.listener.gaussians(gaussians, labels);
    }
}
