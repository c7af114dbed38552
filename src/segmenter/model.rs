//! The network: an ONNX file that fits its contract.

use super::contract::{Contract, Layout};
use super::graph::{self, UNFIT_HELP, one_line};
use super::index;
use crate::error::{Error, Result, ensure, invalid};
use ndarray::Ix4;
use std::cell::Cell;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::{
    Datum, Framework, InferenceFact, InferenceModelExt, IntoRunnable, Tensor, TractError,
    TypedFact, TypedModel, TypedRunnableModel, tvec,
};

/// Values of a tensor within a network, at most: 4 GB.
const MAX_TENSOR_VALUES: u128 = 1 << 30;

/// A network that was read and prepared for one size of input.
pub struct Network {
    /// How it reads photos and what it says.
    pub contract: Contract,
    /// The file.
    pub file: PathBuf,
    /// SHA-256 of the file, in hexadecimal digits.
    pub digest: String,
    output: String,
    /// Shape of the output.
    shape: [usize; 4],
    plan: Arc<TypedRunnableModel>,
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Network")
            .field("file", &self.file)
            .finish_non_exhaustive()
    }
}

impl Network {
    /// Reads the ONNX file and prepares the network for the input of `contract`.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] naming tensor or operator, where the file is cut off or not ONNX, weights lie in
    /// other files or do not fill their shapes, an operator is not implemented, or inputs and outputs differ from the contract in
    /// name, type or shape; [`Error::Limit`] for tensors of more than 4 GB.
    pub fn load(file: &Path, contract: Contract) -> Result<Self> {
        Self::open(file, contract, None)
    }

    /// [`Network::load`] with `tensor` for the output: any tensor within the network that has four dimensions.
    pub(crate) fn open(file: &Path, contract: Contract, tensor: Option<&str>) -> Result<Self> {
        let bytes = crate::files::read(file)?;
        let digest = index::digest(&bytes);
        let (proto, output) = graph::read(file, &bytes, &contract, tensor)?;
        drop(bytes);
        let typed = guarded(file, || typed(&proto, &contract))?;
        drop(proto);
        check_sizes(file, &typed)?;
        let fact = guarded(file, || typed.output_fact(0).cloned())?;
        let shape = match tensor {
            None => check_output(file, &fact, &output, &contract)?,
            Some(_) => shape_of_map(file, &fact, &output)?,
        };
        let plan = guarded(file, || typed.into_optimized()?.into_runnable())?;
        Ok(Self {
            contract,
            file: file.to_owned(),
            digest,
            output,
            shape,
            plan,
        })
    }

    /// The output for an input of the contract's shape: [`Network::map_shape`], row-major.
    ///
    /// # Errors
    /// [`Error::Input`] where the network fails, and for an output of a different shape than the contract says;
    /// [`Error::NonFinite`].
    pub(crate) fn output(&self, input: &[f32]) -> Result<Vec<f32>> {
        let shape = self.contract.input_shape();
        let (shape, values) = guarded(&self.file, || {
            let input = Tensor::from_shape(&shape, input)?;
            let outputs = self.plan.run(tvec!(input.into()))?;
            let values = outputs[0].to_plain_array_view::<f32>()?;
            let values = values.into_dimensionality::<Ix4>()?;
            let shape = values.shape().to_vec();
            let map = match self.contract.output.layout {
                Layout::Nchw => values.permuted_axes([0, 2, 3, 1]),
                Layout::Nhwc => values,
            };
            Ok((shape, map.iter().copied().collect::<Vec<f32>>()))
        })?;
        ensure!(shape == self.shape, &self.file, "tensor {}", self.output; found "{shape:?}";
            expected "{:?}", self.shape; help "{UNFIT_HELP}");
        let name = || format!("{} of {}", self.output, self.file.display());
        match values.iter().position(|v| !v.is_finite()) {
            Some(row) => Err(Error::non_finite(name(), row)),
            None => Ok(values),
        }
    }

    /// Name of the output.
    pub(super) fn output_name(&self) -> &str {
        &self.output
    }

    /// Rows, columns and channels of the output.
    pub(crate) fn map_shape(&self) -> [usize; 3] {
        let [_, a, b, c] = self.shape;
        match self.contract.output.layout {
            Layout::Nchw => [b, c, a],
            Layout::Nhwc => [a, b, c],
        }
    }

    /// Bytes of memory that a photo takes while the network runs, about: the largest layer with its inputs, twice.
    pub(super) fn working_bytes(&self) -> usize {
        let model = self.plan.model();
        let volume = |fact: &TypedFact| {
            let shape = fact.shape.as_concrete().unwrap_or_default();
            shape.iter().product::<usize>()
        };
        let layer = |node: &tract_onnx::prelude::TypedNode| {
            let inputs = model.node_input_facts(node.id).unwrap_or_default();
            let inputs = inputs
                .iter()
                .filter(|fact| fact.konst.is_none())
                .map(|fact| volume(fact));
            let outputs = node.outputs.iter().map(|output| volume(&output.fact));
            inputs.chain(outputs).sum::<usize>()
        };
        8 * model.nodes().iter().map(layer).max().unwrap_or(0)
    }
}

thread_local! {
    /// Whether this thread is in [`guarded`].
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Whether a panic of this thread becomes an error: then a program need not report it.
pub fn is_guarded() -> bool {
    GUARDED.get()
}

/// Runs `work` of the ONNX library. Its errors and, for files that it did not foresee, its panics become errors.
fn guarded<T>(file: &Path, work: impl FnOnce() -> Result<T, TractError>) -> Result<T> {
    GUARDED.set(true);
    let caught = catch_unwind(AssertUnwindSafe(work));
    GUARDED.set(false);
    let found = match caught {
        Ok(Ok(value)) => return Ok(value),
        Ok(Err(error)) => one_line(&format!("{error:#}")),
        Err(_) => "a graph that is malformed".to_owned(),
    };
    Err(
        invalid!(file, "network"; found "{found}"; expected "an ONNX network that tract runs"; help "{UNFIT_HELP}"),
    )
}

/// The network for the contract's input.
fn typed(proto: &ModelProto, contract: &Contract) -> Result<TypedModel, TractError> {
    // Declared shapes within the graph may be of another batch or size.
    let onnx = tract_onnx::onnx().with_ignore_value_info(true);
    let mut model = onnx.model_for_proto_model(proto)?;
    let shape = contract.input_shape();
    model.set_input_fact(0, InferenceFact::dt_shape(f32::datum_type(), shape))?;
    model.into_typed()
}

/// Refuses tensors that no memory holds.
fn check_sizes(file: &Path, model: &TypedModel) -> Result<()> {
    for node in model.nodes() {
        for output in &node.outputs {
            let Some(shape) = output.fact.shape.as_concrete() else {
                continue;
            };
            let volume: u128 = shape
                .iter()
                .fold(1, |all, &side| all.saturating_mul(side as u128));
            ensure!(volume <= MAX_TENSOR_VALUES,
                limit "{}: values of tensor {} of shape {shape:?}", file.display(), node.name;
                found "{volume}"; expected "{MAX_TENSOR_VALUES}"; help "use a smaller network or a smaller input");
        }
    }
    Ok(())
}

/// Type and shape of a tensor.
fn described(fact: &TypedFact) -> String {
    let shape = fact.shape.as_concrete();
    let shape = shape.map_or_else(|| format!("{:?}", fact.shape), |shape| format!("{shape:?}"));
    format!("{:?} {shape}", fact.datum_type)
}

/// The shape of the output, which must be the contract's.
fn check_output(
    file: &Path,
    fact: &TypedFact,
    name: &str,
    contract: &Contract,
) -> Result<[usize; 4]> {
    let expected = contract.output_shape();
    let is_expected = fact.shape.as_concrete() == Some(&expected[..]);
    let [width, height] = contract.input.size;
    ensure!(fact.datum_type == f32::datum_type() && is_expected, file, "tensor {name}"; found "{}", described(fact);
        expected "F32 {expected:?}: {} classes and stride {} for an input of {width}x{height}, as {} says",
            contract.classes.names.len(), contract.output.stride, contract.file.display();
        help "{UNFIT_HELP}");
    Ok(expected)
}

/// The shape of a tensor within the network, which must be one map of a photo.
fn shape_of_map(file: &Path, fact: &TypedFact, name: &str) -> Result<[usize; 4]> {
    let shape = fact
        .shape
        .as_concrete()
        .and_then(|shape| <[usize; 4]>::try_from(shape).ok());
    let is_map = |shape: &[usize; 4]| {
        fact.datum_type == f32::datum_type() && shape[0] == 1 && !shape.contains(&0)
    };
    shape.filter(is_map).ok_or_else(|| {
        invalid!(file, "tensor {name}"; found "{}", described(fact); expected "F32 [1, channels, rows, columns]";
            help "name another tensor")
    })
}
