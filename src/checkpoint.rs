//! Checkpoints: named tensors and settings in one safetensors file. A crash while it is written leaves the old file whole.
//!
//! A checksum covers every byte: a damaged file is refused. Settings are one JSON object under the key `coseg` of `__metadata__`.
//! Their finite numbers come back bit for bit. JSON has no NaN and no infinity: numbers that may be one belong in tensors.

use crate::error::{Error, Result, ensure, invalid};
use crate::files::{self, atomic};
use crate::seal;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Version of the layout; files of another one are refused.
const VERSION: u64 = 5;
/// Key of the JSON object within `__metadata__`.
const KEY: &str = "coseg";

/// Scalar types that a checkpoint holds.
pub trait Scalar: Sized {
    /// The type in the file.
    const DTYPE: Dtype;
    /// Little-endian bytes of values.
    fn to_bytes(values: &[Self]) -> Vec<u8>;
    /// Values of little-endian bytes.
    fn from_bytes(bytes: &[u8]) -> Vec<Self>;
}

macro_rules! scalar {
    ($type:ty, $dtype:ident) => {
        impl Scalar for $type {
            const DTYPE: Dtype = Dtype::$dtype;
            fn to_bytes(values: &[Self]) -> Vec<u8> {
                values.iter().flat_map(|v| v.to_le_bytes()).collect()
            }
            fn from_bytes(bytes: &[u8]) -> Vec<Self> {
                let (scalars, _) = bytes.as_chunks();
                scalars.iter().map(|b| Self::from_le_bytes(*b)).collect()
            }
        }
    };
}
scalar!(half::f16, F16);
scalar!(half::bf16, BF16);
scalar!(f32, F32);
scalar!(f64, F64);
scalar!(u32, U32);
scalar!(u64, U64);

/// A stored tensor.
#[derive(Clone, Debug, PartialEq)]
struct Stored {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

/// Named tensors and settings, in memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checkpoint {
    /// The file, for error messages.
    path: PathBuf,
    kind: String,
    settings: BTreeMap<String, serde_json::Value>,
    tensors: BTreeMap<String, Stored>,
}

impl Checkpoint {
    /// An empty checkpoint of a `kind`, such as `building`.
    pub fn new(kind: impl Into<String>) -> Self {
        Self {
            kind: kind.into(),
            ..Self::default()
        }
    }

    /// Adds a tensor, row-major.
    ///
    /// # Errors
    /// [`Error::Limit`] when the number of values is not that of `shape`.
    pub fn put<T: Scalar>(
        &mut self,
        name: impl Into<String>,
        shape: &[usize],
        values: Vec<T>,
    ) -> Result<()> {
        let name = name.into();
        ensure!(values.len() == shape.iter().product::<usize>(),
            limit "values of checkpoint tensor {name}"; found "{}", values.len(); expected "{shape:?}";
            help "give as many values as the shape has");
        let tensor = Stored {
            dtype: T::DTYPE,
            shape: shape.to_vec(),
            bytes: T::to_bytes(&values),
        };
        self.tensors.insert(name, tensor);
        Ok(())
    }

    /// Shape of a tensor.
    ///
    /// # Errors
    /// [`Error::Input`] when there is none of this name.
    pub fn shape(&self, name: &str) -> Result<&[usize]> {
        match self.tensors.get(name) {
            Some(tensor) => Ok(&tensor.shape),
            None => Err(self.wrong(format!("tensor {name}"), "nothing", "a tensor of this name")),
        }
    }

    /// Moves a tensor out, checking its type and shape.
    ///
    /// # Errors
    /// [`Error::Input`] naming file and tensor when it is missing or of another type or shape.
    pub fn take<T: Scalar>(&mut self, name: &str, shape: &[usize]) -> Result<Vec<T>> {
        let found = self.shape(name)?;
        let field = format!("tensor {name}");
        if found != shape {
            let found = format!("shape {found:?}");
            return Err(self.wrong(field, found, format!("shape {shape:?}")));
        }
        match self.tensors.remove(name) {
            Some(tensor) if tensor.dtype == T::DTYPE => Ok(T::from_bytes(&tensor.bytes)),
            other => {
                let found = format!("type {:?}", other.map(|tensor| tensor.dtype));
                Err(self.wrong(field, found, format!("type {:?}", T::DTYPE)))
            }
        }
    }

    /// Adds a setting.
    ///
    /// # Errors
    /// [`Error::Config`] when the value cannot be written as JSON.
    pub fn set<T: Serialize>(&mut self, key: &str, value: &T) -> Result<()> {
        let expected = "a value that JSON can hold";
        let value = serde_json::to_value(value).map_err(|e| {
            invalid!(setting "{key}"; found "{e}"; expected "{expected}";
                help "change the value")
        })?;
        self.settings.insert(key.to_owned(), value);
        Ok(())
    }

    /// Reads a setting.
    ///
    /// # Errors
    /// [`Error::Input`] naming file and key when it is missing or of another type.
    pub fn get<T: DeserializeOwned>(&self, key: &str) -> Result<T> {
        let field = format!("metadata {key}");
        let Some(value) = self.settings.get(key) else {
            return Err(self.wrong(field, "nothing", "a value"));
        };
        serde_json::from_value(value.clone())
            .map_err(|e| self.wrong(field, e.to_string(), std::any::type_name::<T>()))
    }

    /// The kind of state.
    pub fn kind(&self) -> &str {
        &self.kind
    }

    /// An [`Error::Input`] about this checkpoint's file.
    pub fn wrong(
        &self,
        field: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Error {
        let help = "resume from another checkpoint, or start the run again";
        Error::input(&self.path, field, found, expected, help)
    }

    /// Writes `path`; what stood there before stays whole until the new file is on disk.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let settings =
            serde_json::json!({ "kind": self.kind, "version": VERSION, "settings": self.settings });
        let metadata = HashMap::from([(KEY.to_owned(), settings.to_string())]);
        let views = self.tensors.iter().map(|(name, tensor)| {
            let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes)?;
            Ok((name.as_str(), view))
        });
        let views: Result<Vec<_>, SafeTensorError> = views.collect();
        let bytes = views
            .and_then(|views| seal::sealed(views, Some(metadata)))
            .map_err(|e| Error::io(path, "encode", std::io::Error::other(e.to_string())))?;
        atomic::write_bytes(path, &bytes)
    }

    /// Reads a checkpoint of `kind`.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Input`] when it is truncated or damaged, no checkpoint, or of another
    /// kind or version.
    pub fn load(path: &Path, kind: &str) -> Result<Self> {
        let bytes = files::read(path)?;
        let mut checkpoint = Self {
            path: path.to_owned(),
            kind: kind.to_owned(),
            ..Self::default()
        };
        let damaged = |e| {
            let found = format!("{} bytes, {e}", bytes.len());
            checkpoint.wrong("header", found, "a whole safetensors file")
        };
        let file = SafeTensors::deserialize(&bytes).map_err(damaged)?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
        let text = header.metadata().as_ref().and_then(|m| m.get(KEY));
        let mut json: serde_json::Value = match text {
            Some(text) => serde_json::from_str(text)
                .map_err(|e| checkpoint.wrong("metadata", e.to_string(), "a JSON object"))?,
            None => serde_json::Value::Null,
        };
        for (key, expected) in [
            ("version", serde_json::json!(VERSION)),
            ("kind", kind.into()),
        ] {
            if json[key] != expected {
                let field = format!("metadata {key}");
                let found = json[key].to_string();
                return Err(checkpoint.wrong(field, found, expected.to_string()));
            }
        }
        // After the version: earlier ones had none.
        let help = "resume from another checkpoint, or start the run again";
        seal::check(&bytes, path, help)?;
        checkpoint.settings = serde_json::from_value(json["settings"].take()).unwrap_or_default();
        let tensors = file.tensors().into_iter();
        for (name, view) in tensors.filter(|(name, _)| name != seal::NAME) {
            let tensor = Stored {
                dtype: view.dtype(),
                shape: view.shape().to_vec(),
                bytes: view.data().to_vec(),
            };
            checkpoint.tensors.insert(name, tensor);
        }
        Ok(checkpoint)
    }
}
