//! Named tensors read from PyTorch and safetensors files.

use crate::checkpoint::Scalar;
use crate::error::{Error, Result, invalid};
use crate::files::{self, atomic, extension};
use crate::seal;
use burn::store::pytorch_reader::{DType as TorchType, PytorchReader};
use half::{bf16, f16};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors, View};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Keys under which training scripts nest their weights.
const STATE_DICT_KEYS: [&str; 3] = ["model_state_dict", "state_dict", "model"];

/// A tensor in host memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HostTensor {
    /// Extents, outermost first.
    pub shape: Vec<usize>,
    /// Row-major values.
    pub values: Vec<f32>,
}

impl View for &HostTensor {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        f32::to_bytes(&self.values).into()
    }
    fn data_len(&self) -> usize {
        4 * self.values.len()
    }
}

/// Little-endian numbers of a floating-point type as f32; none for other types.
pub(crate) fn floats(bytes: &[u8], dtype: Dtype) -> Option<Vec<f32>> {
    match dtype {
        Dtype::F32 => Some(f32::from_bytes(bytes)),
        Dtype::F64 => Some(f64::from_bytes(bytes).iter().map(|&v| v as f32).collect()),
        Dtype::F16 => Some(f16::from_bytes(bytes).iter().map(|v| v.to_f32()).collect()),
        Dtype::BF16 => Some(bf16::from_bytes(bytes).iter().map(|v| v.to_f32()).collect()),
        _ => None,
    }
}

/// All floating-point tensors of a weight file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WeightFile {
    /// Where they came from, for messages.
    pub origin: PathBuf,
    /// By name, without a leading `module.` and without [`WeightFile::prefix`].
    pub tensors: BTreeMap<String, HostTensor>,
    /// The file's own notes (safetensors only).
    pub metadata: BTreeMap<String, String>,
    /// The network that [`WeightFile::get`] asks for in its messages.
    pub network: &'static str,
    /// What precedes the names in the file.
    pub prefix: String,
}

impl WeightFile {
    /// Reads a `.safetensors` file, or anything else as a PyTorch checkpoint (zip, legacy or tar), nested under
    /// `model_state_dict`, `state_dict`, `model` or not at all.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Input`] when it is truncated, or is not such a file.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_where(path, |_| true)
    }

    /// [`WeightFile::open`] for the tensors whose name in the file `keep` accepts: the rest is not read from PyTorch files.
    ///
    /// # Errors
    /// As [`WeightFile::open`].
    pub fn open_where(path: impl AsRef<Path>, keep: impl Fn(&str) -> bool) -> Result<Self> {
        let path = path.as_ref();
        if extension(path) == "safetensors" {
            let bytes = files::read(path)?;
            return Self::selected(&bytes, path, keep);
        }
        files::open(path)?;
        let reader = PytorchReader::new(path).map_err(|e| unreadable(path, "checkpoint", e))?;
        let mut weights = Self {
            origin: path.to_owned(),
            ..Self::default()
        };
        for (name, tensor) in reader.tensors().iter().filter(|(name, _)| keep(name)) {
            let dtype = match tensor.dtype() {
                TorchType::F32 => Dtype::F32,
                TorchType::F64 => Dtype::F64,
                TorchType::F16 => Dtype::F16,
                TorchType::BF16 => Dtype::BF16,
                _ => continue, // counters such as num_batches_tracked
            };
            let bytes = tensor.read().map_err(|e| unreadable(path, name, e))?;
            let values = floats(&bytes, dtype).unwrap_or_default();
            let shape = tensor.shape().to_vec();
            let name = STATE_DICT_KEYS
                .iter()
                .find_map(|n| name.strip_prefix(n)?.strip_prefix('.'))
                .unwrap_or(name);
            weights.insert(name, HostTensor { shape, values });
        }
        Ok(weights)
    }

    /// Reads what [`WeightFile::write_one`] wrote.
    ///
    /// # Errors
    /// As [`WeightFile::open`]; [`Error::Input`] for bytes that were changed since.
    pub(crate) fn open_sealed(path: &Path) -> Result<Self> {
        let bytes = files::read(path)?;
        let file = Self::selected(&bytes, path, |_| true)?;
        seal::check(&bytes, path, "write the run again with `coseg train`")?;
        Ok(file)
    }

    /// Reads the bytes of a safetensors file; `origin` names them in messages.
    ///
    /// # Errors
    /// [`Error::Input`] when the bytes are truncated or are not a safetensors file.
    pub fn from_safetensors(bytes: &[u8], origin: impl AsRef<Path>) -> Result<Self> {
        Self::selected(bytes, origin.as_ref(), |_| true)
    }

    fn selected(bytes: &[u8], origin: &Path, keep: impl Fn(&str) -> bool) -> Result<Self> {
        let file = SafeTensors::deserialize(bytes).map_err(|e| unreadable(origin, "header", e))?;
        let (_, header) =
            SafeTensors::read_metadata(bytes).map_err(|e| unreadable(origin, "header", e))?;
        let metadata = header
            .metadata()
            .iter()
            .flatten()
            .map(|(k, v)| (k.clone(), v.clone()))
            .collect();
        let mut weights = Self {
            origin: origin.to_owned(),
            metadata,
            ..Self::default()
        };
        for (name, view) in file.iter().filter(|(name, _)| keep(name)) {
            if let Some(values) = floats(view.data(), view.dtype()) {
                let shape = view.shape().to_vec();
                weights.insert(name, HostTensor { shape, values });
            }
        }
        Ok(weights)
    }

    /// The bytes of a safetensors file with these tensors and notes.
    ///
    /// # Errors
    /// [`Error::Input`] when they cannot be encoded.
    pub fn to_safetensors(&self) -> Result<Vec<u8>> {
        let metadata = (!self.metadata.is_empty()).then(|| self.metadata.clone());
        safetensors::serialize(&self.tensors, metadata.map(HashMap::from_iter))
            .map_err(|e| unreadable(&self.origin, "tensors", e))
    }

    /// Writes a safetensors file with one tensor and a checksum, atomically.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be written.
    pub(crate) fn write_one(path: &Path, name: &str, tensor: HostTensor) -> Result<()> {
        let values = f32::to_bytes(&tensor.values);
        let bytes = TensorView::new(Dtype::F32, tensor.shape, &values)
            .and_then(|view| seal::sealed([(name, view)], None))
            .map_err(|e| unreadable(path, "tensors", e))?;
        atomic::write_bytes(path, &bytes)
    }

    /// The tensors whose names start with `prefix`, named without it. Messages name them as the file does.
    pub(crate) fn under(mut self, prefix: &str) -> Self {
        let tensors = std::mem::take(&mut self.tensors).into_iter();
        self.tensors = tensors
            .filter_map(|(name, tensor)| Some((name.strip_prefix(prefix)?.to_owned(), tensor)))
            .collect();
        self.prefix.push_str(prefix);
        self
    }

    /// The same, with the network named that messages of [`WeightFile::get`] ask for.
    pub fn of_network(mut self, network: &'static str) -> Self {
        self.network = network;
        self
    }

    /// Adds a tensor under `name`, without a leading `module.` (DataParallel).
    pub fn insert(&mut self, name: &str, tensor: HostTensor) {
        self.tensors.insert(
            name.strip_prefix("module.").unwrap_or(name).to_owned(),
            tensor,
        );
    }

    /// The tensor `name`, its trailing extents of 1 dropped (1x1 convolutions are linear maps).
    ///
    /// # Errors
    /// [`Error::Input`] when it is missing, has a different shape than `shape`, or holds a value that is not finite.
    pub fn get(&self, name: &str, shape: &[usize]) -> Result<&[f32]> {
        let tensor = self
            .tensors
            .get(name)
            .ok_or_else(|| self.problem(name, "no such tensor", format!("{shape:?}")))?;
        let mut found = tensor.shape.as_slice();
        while found.len() > shape.len() && found.last() == Some(&1) {
            found = &found[..found.len() - 1];
        }
        if found != shape {
            return Err(self.problem(
                name,
                format!("shape {:?}", tensor.shape),
                format!("{shape:?}"),
            ));
        }
        match tensor.values.iter().position(|v| !v.is_finite()) {
            Some(i) => Err(self.problem(
                name,
                format!("{} at element {i}", tensor.values[i]),
                "finite values",
            )),
            None => Ok(&tensor.values),
        }
    }

    /// Extents of the tensor `name`.
    ///
    /// # Errors
    /// [`Error::Input`] when it is missing.
    pub fn shape(&self, name: &str) -> Result<&[usize]> {
        match self.tensors.get(name) {
            Some(tensor) => Ok(&tensor.shape),
            None => Err(self.problem(name, "no such tensor", "one")),
        }
    }

    /// The error for a tensor that [`WeightFile::network`] cannot use.
    pub(crate) fn problem(&self, name: &str, found: impl Display, expected: impl Display) -> Error {
        let network = if self.network.is_empty() {
            "the expected network"
        } else {
            self.network
        };
        invalid!(&self.origin, "{}{name}", self.prefix; found "{found}"; expected "{expected}";
            help "give a checkpoint of {network}")
    }
}

fn unreadable(path: &Path, field: &str, cause: impl Display) -> Error {
    invalid!(path, "{field}"; found "{cause}"; expected "a whole weight file";
        help "check that the download is complete")
}
