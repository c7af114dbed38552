//! Warnings of the library as records of the logger `coseg` of Python's `logging`.

use pyo3::prelude::*;
use std::fmt::{Debug, Write};
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::layer::{Context, Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{filter, registry};

/// Forwards warnings from now on. Another subscriber of this process, if there is one, stays.
pub fn forward() {
    let ours = filter::Targets::new().with_target("coseg", Level::WARN);
    let _ = registry().with(Logger.with_filter(ours)).try_init();
}

struct Logger;

impl<S: Subscriber> Layer<S> for Logger {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut message = Message::default();
        event.record(&mut message);
        // No record can be made while Python shuts down. An error in the user's handler is not an error of the work.
        let _ = Python::try_attach(|py| -> PyResult<()> {
            let logger = py
                .import("logging")?
                .call_method1("getLogger", ("coseg",))?;
            logger.call_method1("warning", ("%s", message.0))?;
            Ok(())
        });
    }
}

/// The text of an event.
#[derive(Default)]
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            // A string takes everything.
            let _ = write!(self.0, "{value:?}");
        }
    }
}
