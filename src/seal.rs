//! Safetensors files that hold their own checksum.

use crate::error::{Result, ensure};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::ops::Range;
use std::path::Path;

/// Tensor with the SHA-256 of the file, computed while its own bytes are 0.
pub(crate) const NAME: &str = "sha256";
const EMPTY: [u8; 32] = [0; 32];

/// The bytes of a safetensors file with these tensors and notes, and its checksum.
pub(crate) fn sealed<'a>(
    tensors: impl IntoIterator<Item = (&'a str, TensorView<'a>)>,
    notes: Option<HashMap<String, String>>,
) -> Result<Vec<u8>, SafeTensorError> {
    let checksum = TensorView::new(Dtype::U8, vec![EMPTY.len()], &EMPTY)?;
    let all = tensors.into_iter().chain([(NAME, checksum)]);
    let mut bytes = safetensors::serialize(all, notes)?;
    if let Some(place) = place(&bytes) {
        let digest = digest(&bytes, &place);
        bytes[place].copy_from_slice(&digest);
    }
    Ok(bytes)
}

/// Refuses `bytes` of the file `path` that are not those that were written.
///
/// # Errors
/// [`crate::Error::Input`].
pub(crate) fn check(bytes: &[u8], path: &Path, help: &str) -> Result<()> {
    let intact = place(bytes).is_some_and(|place| bytes[place.clone()] == digest(bytes, &place));
    ensure!(intact, path, "checksum"; found "bytes other than those written"; expected "a whole file of this version of coseg";
        help "{help}");
    Ok(())
}

/// Where the checksum stands.
fn place(bytes: &[u8]) -> Option<Range<usize>> {
    let (header, metadata) = SafeTensors::read_metadata(bytes).ok()?;
    let (from, to) = metadata.info(NAME)?.data_offsets;
    // The header follows its length of eight bytes.
    let start = header.checked_add(8)?;
    let place = start.checked_add(from)?..start.checked_add(to)?;
    (place.len() == EMPTY.len() && place.end <= bytes.len()).then_some(place)
}

fn digest(bytes: &[u8], place: &Range<usize>) -> [u8; 32] {
    let hash = Sha256::new().chain_update(&bytes[..place.start]);
    let hash = hash.chain_update(EMPTY).chain_update(&bytes[place.end..]);
    hash.finalize().into()
}
