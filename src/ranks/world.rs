//! The ranks of MPI. A failure inside MPI ends all of them, as MPI does by default.

use mpi::Threading;
use mpi::collective::SystemOperation;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives, Equivalence};
use std::sync::{PoisonError, RwLock};

/// Values that one call of MPI sums; its counts have 31 bits.
const CHUNK: usize = 1 << 24;

static UNIVERSE: RwLock<Option<Universe>> = RwLock::new(None);

/// A number that MPI can add.
pub trait Number: Equivalence + Copy + Default {}
impl<T: Equivalence + Copy + Default> Number for T {}

/// Joins the others: the number of this rank, and how many there are.
pub fn start() -> Option<(usize, usize)> {
    let (universe, _) = mpi::initialize_with_threading(Threading::Funneled)?;
    let world = universe.world();
    let mut slot = UNIVERSE.write().unwrap_or_else(PoisonError::into_inner);
    *slot = Some(universe);
    Some((world.rank() as usize, world.size() as usize))
}

/// Leaves the others.
pub fn finish() {
    UNIVERSE
        .write()
        .unwrap_or_else(PoisonError::into_inner)
        .take();
}

/// Ends all ranks.
pub fn abort() {
    if let Some(world) = world() {
        world.abort(1);
    }
}

fn world() -> Option<SimpleCommunicator> {
    let universe = UNIVERSE.read().unwrap_or_else(PoisonError::into_inner);
    universe.as_ref().map(Universe::world)
}

/// Sums `values` over all ranks.
pub fn sum<T: Number>(values: &mut [T]) {
    let Some(world) = world() else { return };
    for chunk in values.chunks_mut(CHUNK) {
        let own = chunk.to_vec();
        world.all_reduce_into(&own[..], chunk, SystemOperation::sum());
    }
}

/// `bytes` of all ranks.
pub fn gather(bytes: &[u8]) -> Vec<Vec<u8>> {
    let Some(world) = world() else {
        return vec![bytes.to_vec()];
    };
    let mut lengths = vec![0_i32; world.size() as usize];
    world.all_gather_into(&(bytes.len() as i32), &mut lengths[..]);
    let starts = lengths.iter().scan(0, |end, length| {
        *end += length;
        Some(*end - length)
    });
    let starts: Vec<i32> = starts.collect();
    let mut all = vec![0; lengths.iter().map(|&length| length as usize).sum()];
    let mut parts = PartitionMut::new(&mut all[..], &lengths[..], &starts[..]);
    world.all_gather_varcount_into(bytes, &mut parts);
    let mut rest = &all[..];
    let each = lengths.iter().map(|&length| {
        let (part, behind) = rest.split_at(length as usize);
        rest = behind;
        part.to_vec()
    });
    each.collect()
}
