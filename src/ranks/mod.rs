//! Ranks: the processes of one `mpirun`, which train one run together.
//!
//! Each rank holds the whole scene and computes on its share of the views. What they find is summed or gathered, to the same bits
//! on every rank, so all ranks take the same decisions. All of them have to call [`sum`], [`gather`] and what uses these in the
//! same order. A process that `mpirun` did not start is one rank alone; these functions then change nothing.

#[cfg(feature = "mpi")]
mod world;

#[cfg(not(feature = "mpi"))]
use self::alone as world;
use crate::backend::device::{read, upload};
use crate::error::{Error, Result, bail, ensure};
use burn::tensor::Tensor;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

/// Number of this rank, how many there are, and bytes that it has put into sums and gathered values.
static INDEX: AtomicUsize = AtomicUsize::new(0);
static COUNT: AtomicUsize = AtomicUsize::new(1);
static SENT: AtomicU64 = AtomicU64::new(0);

/// Bytes of all ranks that one call of [`gather`] takes: MPI counts them in 31 bits.
const MAX_GATHERED: usize = i32::MAX as usize;

/// Variables by which programs that start ranks tell how many there are: Open MPI; MPICH and others with PMI.
const SIZES: [&str; 2] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"];

/// Joins the other ranks, where `mpirun` started more than this one. Call it once, on the main thread.
///
/// # Errors
/// [`Error::Argument`] if there are others that this build cannot join.
pub fn start() -> Result<()> {
    let sizes = SIZES.iter().filter_map(|name| std::env::var(name).ok());
    let started: usize = sizes
        .filter_map(|size| size.parse().ok())
        .max()
        .unwrap_or(1);
    if started < 2 {
        return Ok(());
    }
    let Some((index, count)) = world::start() else {
        bail!(argument "mpirun"; found "{started} processes"; expected "a build that joins them";
            help "build with `--features mpi`");
    };
    ensure!(count == started, argument "mpirun"; found "{started} processes, of which {count} joined";
        expected "all"; help "use the mpirun of the MPI library that coseg was built with");
    INDEX.store(index, Ordering::Relaxed);
    COUNT.store(count, Ordering::Relaxed);
    Ok(())
}

/// Leaves the other ranks: from now on this process is alone. All of them call it on the main thread.
pub fn finish() {
    INDEX.store(0, Ordering::Relaxed);
    COUNT.store(1, Ordering::Relaxed);
    world::finish();
}

/// Ends all ranks at once, if there are others.
pub fn abort() {
    world::abort();
}

/// Number of this rank, from 0.
pub fn index() -> usize {
    INDEX.load(Ordering::Relaxed)
}

/// Number of ranks.
pub fn count() -> usize {
    COUNT.load(Ordering::Relaxed)
}

/// Bytes that this rank has put into sums and gathered values so far.
pub fn sent() -> u64 {
    SENT.load(Ordering::Relaxed)
}

/// What ranks put into sums and gathered values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traffic {
    /// How many there were.
    pub ranks: usize,
    /// Bytes of one of them in stage one.
    pub building_bytes: u64,
    /// The same in a step of stage one.
    pub building_step_bytes: u64,
    /// Bytes of one of them afterwards.
    pub segmentation_bytes: u64,
}

/// The items whose turn it is on this rank: one of every [`count`].
pub fn share<T>(items: impl IntoIterator<Item = T>) -> impl Iterator<Item = T> {
    items.into_iter().skip(index()).step_by(count())
}

/// A number that ranks sum.
pub trait Summand: world::Number {}
impl Summand for f32 {}
impl Summand for f64 {}
impl Summand for u64 {}

/// Sums `values` over all ranks, which have as many.
pub fn sum<T: Summand>(values: &mut [T]) {
    if count() > 1 {
        SENT.fetch_add(size_of_val(values) as u64, Ordering::Relaxed);
        world::sum(values);
    }
}

/// The sum of `tensor`, called `what`, over all ranks.
///
/// # Errors
/// [`Error::Device`] when the device does not return it.
pub fn sum_tensor<const D: usize>(what: &str, tensor: Tensor<D>) -> Result<Tensor<D>> {
    if count() == 1 {
        return Ok(tensor);
    }
    let mut values = read(what, tensor.clone())?;
    sum(&mut values);
    Ok(upload(values, tensor.dims(), &tensor.device()))
}

/// `value` of every rank, in their order.
///
/// # Errors
/// [`Error::Device`] where one cannot be sent; [`Error::Limit`] for more than 2 GB of all together.
pub fn gather<T: Serialize + DeserializeOwned>(value: T) -> Result<Vec<T>> {
    if count() == 1 {
        return Ok(vec![value]);
    }
    let failed =
        |error: serde_json::Error| diverged(&format!("what it sent is not readable: {error}"));
    let bytes = serde_json::to_vec(&value).map_err(failed)?;
    ensure!(bytes.len() < MAX_GATHERED / count(), limit "what a rank tells the others"; found "{} bytes", bytes.len();
        expected "{} bytes", MAX_GATHERED / count(); help "start fewer ranks");
    SENT.fetch_add(bytes.len() as u64, Ordering::Relaxed);
    let all = world::gather(&bytes);
    all.iter()
        .map(|bytes| serde_json::from_slice(bytes).map_err(failed))
        .collect()
}

/// `value` of rank 0.
///
/// # Errors
/// As [`gather`].
pub fn of_first<T: Serialize + DeserializeOwned>(value: Option<T>) -> Result<T> {
    let first = gather(value)?.into_iter().next().flatten();
    first.ok_or_else(|| diverged("rank 0 sent nothing"))
}

/// Whether any rank says so.
///
/// # Errors
/// As [`gather`].
pub fn any(here: bool) -> Result<bool> {
    Ok(gather(here)?.contains(&true))
}

/// `look` at each of `items`, in their order; each rank looks at its share.
///
/// # Errors
/// Those of `look`, and of [`gather`].
pub fn divided<I, T: Serialize + DeserializeOwned>(
    items: impl IntoIterator<Item = I>,
    look: impl FnMut(I) -> Result<T>,
) -> Result<Vec<T>> {
    interleave(share(items).map(look).collect::<Result<_>>()?)
}

/// What all ranks found for their [`share`] of some items, in the order of the items.
///
/// # Errors
/// Those of [`gather`].
pub fn interleave<T: Serialize + DeserializeOwned>(own: Vec<T>) -> Result<Vec<T>> {
    let mut all: Vec<_> = gather(own)?.into_iter().map(Vec::into_iter).collect();
    let mut found = Vec::new();
    loop {
        let round = found.len();
        found.extend(all.iter_mut().filter_map(Iterator::next));
        if found.len() == round {
            return Ok(found);
        }
    }
}

/// Checks that `value`, called `what`, is the same on all ranks.
///
/// # Errors
/// [`Error::Device`] if it is not.
pub fn expect_same(what: &str, value: String) -> Result<()> {
    let all = gather(value)?;
    match all.iter().position(|other| *other != all[0]) {
        Some(rank) => Err(diverged(&format!(
            "{what} of rank {rank} are not those of rank 0"
        ))),
        None => Ok(()),
    }
}

fn diverged(reason: &str) -> Error {
    Error::Device {
        device: format!("rank {}", index()),
        reason: reason.to_owned(),
        help: "start all ranks with one program, on one kind of processor".to_owned(),
    }
}

/// A rank without others.
#[cfg(not(feature = "mpi"))]
mod alone {
    pub trait Number: Copy {}
    impl<T: Copy> Number for T {}

    pub fn start() -> Option<(usize, usize)> {
        None
    }

    pub fn finish() {}

    pub fn abort() {}

    pub fn sum<T>(_: &mut [T]) {}

    pub fn gather(bytes: &[u8]) -> Vec<Vec<u8>> {
        vec![bytes.to_vec()]
    }
}
