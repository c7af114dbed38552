//! The network: an ONNX file that fits its contract.

use super::contract::Contract;
use crate::error::{Error, Result, invalid};
use sha2::{Digest, Sha256};
use std::cell::Cell;
use std::collections::HashSet;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tract_onnx::pb::{GraphProto, ModelProto, TensorProto, ValueInfoProto};
use tract_onnx::pb::{tensor_proto, tensor_shape_proto, type_proto};
use tract_onnx::prelude::{
    Datum, Framework, InferenceFact, InferenceModelExt, IntoRunnable, Tensor, TractError,
    TypedModel, TypedRunnableModel, tvec,
};

/// Most values of a tensor within a network: 4 GB.
const LARGEST: u128 = 1 << 30;
/// What to do about a network that does not fit.
const OTHER: &str = "choose the contract of this network (--contract), or export the network again";

/// A network that was read and prepared for one size of input.
pub struct Network {
    /// How it reads photos and what it says.
    pub contract: Contract,
    /// The file.
    pub file: PathBuf,
    /// SHA-256 of the file, in hexadecimal digits.
    pub digest: String,
    output: String,
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
    /// [`Error::Io`]; [`Error::Input`] naming tensor or operator: a file that is cut off or no ONNX, weights that lie in other
    /// files or do not fill their shapes, operators that are not implemented, inputs and outputs of other names, types
    /// or shapes than the contract says; [`Error::Limit`] for tensors of more than 4 GB.
    pub fn load(file: &Path, contract: Contract) -> Result<Self> {
        let bytes = std::fs::read(file).map_err(|e| Error::io(file, "read", e))?;
        let digest = format!("{:x}", Sha256::digest(&bytes));
        let mut proto = decode(file, &bytes)?;
        drop(bytes);
        let graph = proto
            .graph
            .as_mut()
            .ok_or_else(|| not_onnx(file, "a file without a graph"))?;
        graph
            .initializer
            .iter()
            .try_for_each(|weights| check_weights(file, weights))?;
        check_operators(file, graph)?;
        check_input(file, graph, &contract)?;
        let output = choose_output(file, graph, contract.output.tensor.as_deref())?;
        let typed = guarded(file, || typed(&proto, &contract))?;
        drop(proto);
        check_sizes(file, &typed)?;
        check_output(file, &typed, &output, &contract)?;
        let plan = guarded(file, || typed.into_optimized()?.into_runnable())?;
        Ok(Self {
            contract,
            file: file.to_owned(),
            digest,
            output,
            plan,
        })
    }

    /// The output for an input of the contract's shape, row-major.
    ///
    /// # Errors
    /// [`Error::Input`] where the network fails, and for an output of another shape than the contract says;
    /// [`Error::NonFinite`].
    pub(super) fn output(&self, input: &[f32]) -> Result<Vec<f32>> {
        let shape = self.contract.input_shape();
        let outputs = guarded(&self.file, || {
            let input = Tensor::from_shape(&shape, input)?;
            let outputs = self.plan.run(tvec!(input.into()))?;
            let values = outputs[0].to_plain_array_view::<f32>()?;
            Ok((
                values.shape().to_vec(),
                values.iter().copied().collect::<Vec<f32>>(),
            ))
        });
        let (shape, values) = outputs?;
        if shape != self.contract.output_shape() {
            return Err(wrong_output(
                &self.file,
                &self.output,
                format!("{shape:?}"),
                &self.contract,
            ));
        }
        let name = || format!("{} of {}", self.output, self.file.display());
        match values.iter().position(|v| !v.is_finite()) {
            Some(row) => Err(Error::non_finite(name(), row)),
            None => Ok(values),
        }
    }

    /// Bytes of memory that a photo takes while the network runs, about: the largest layer with its inputs, twice.
    pub(super) fn working_bytes(&self) -> usize {
        let model = self.plan.model();
        let volume = |fact: &tract_onnx::prelude::TypedFact| {
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
        invalid!(file, "network"; found "{found}"; expected "an ONNX network that tract runs"; help "{OTHER}"),
    )
}

fn one_line(text: &str) -> String {
    let line: String = text.split_whitespace().collect::<Vec<_>>().join(" ");
    line.chars().take(400).collect()
}

fn not_onnx(file: &Path, found: &str) -> Error {
    invalid!(file, "model"; found "{found}"; expected "an ONNX network"; help "copy or export it again")
}

fn decode(file: &Path, bytes: &[u8]) -> Result<ModelProto> {
    if let Some(kind) = crate::files::kind(bytes) {
        return Err(not_onnx(file, kind));
    }
    let proto = tract_onnx::onnx().proto_model_for_read(&mut &*bytes);
    proto.map_err(|e| {
        let found = format!(
            "{} bytes that are damaged or cut off ({})",
            bytes.len(),
            one_line(&format!("{e:#}"))
        );
        not_onnx(file, &found)
    })
}

/// Refuses weights that do not fill their shape.
fn check_weights(file: &Path, weights: &TensorProto) -> Result<()> {
    let name = &weights.name;
    if weights.data_location == Some(tensor_proto::DataLocation::External as i32) {
        return Err(
            invalid!(file, "tensor {name}"; found "weights in another file"; expected "weights in this file";
            help "save the network as one file; in Python: onnx.save(onnx.load(path), path)"),
        );
    }
    let shape = &weights.dims;
    let volume = shape.iter().try_fold(1_u128, |all, &side| {
        all.checked_mul(u128::try_from(side).ok()?)
    });
    let stored = [
        weights.float_data.len(),
        weights.int32_data.len(),
        weights.int64_data.len(),
        weights.double_data.len(),
        weights.uint64_data.len(),
        weights.string_data.len(),
    ];
    let raw = weights.raw_data.len() as u128;
    let bytes = value_bytes(weights.data_type);
    let fits = volume.is_some_and(|volume| {
        let is_raw = bytes.is_some_and(|bytes| Some(raw) == volume.checked_mul(bytes));
        if raw > 0 {
            is_raw
        } else {
            volume == stored.iter().map(|n| *n as u128).sum::<u128>()
        }
    });
    if fits {
        return Ok(());
    }
    Err(
        invalid!(file, "tensor {name}"; found "shape {shape:?} with {raw} bytes, {} numbers", stored.iter().sum::<usize>();
        expected "as many values as the shape has"; help "copy or export the network again"),
    )
}

/// Bytes of a value of an ONNX type.
fn value_bytes(kind: i32) -> Option<u128> {
    use tensor_proto::DataType as Type;
    Some(match Type::try_from(kind).ok()? {
        Type::Uint8 | Type::Int8 | Type::Bool => 1,
        Type::Uint16 | Type::Int16 | Type::Float16 | Type::Bfloat16 => 2,
        Type::Float | Type::Int32 | Type::Uint32 => 4,
        Type::Double | Type::Int64 | Type::Uint64 => 8,
        _ => return None,
    })
}

fn check_operators(file: &Path, graph: &GraphProto) -> Result<()> {
    let known = tract_onnx::onnx().op_register.0;
    let unknown = graph
        .node
        .iter()
        .find(|node| !known.contains_key(&node.op_type));
    unknown.map_or(Ok(()), |node| {
        Err(
            invalid!(file, "operator {:?}", node.name; found "{:?}", node.op_type; expected "an operator that tract implements";
            help "export the network with other operators or another opset"),
        )
    })
}

/// Refuses a network whose inputs are not the one of the contract.
fn check_input(file: &Path, graph: &GraphProto, contract: &Contract) -> Result<()> {
    let weights: HashSet<&str> = graph
        .initializer
        .iter()
        .map(|weights| weights.name.as_str())
        .collect();
    let inputs: Vec<&ValueInfoProto> = graph
        .input
        .iter()
        .filter(|input| !weights.contains(input.name.as_str()))
        .collect();
    let named = |input: &ValueInfoProto| {
        contract
            .input
            .tensor
            .as_ref()
            .is_none_or(|name| *name == input.name)
    };
    let [input] = inputs[..] else {
        return Err(
            invalid!(file, "inputs"; found "{}", described(&inputs); expected "one input"; help "{OTHER}"),
        );
    };
    if !named(input) {
        let expected = contract.input.tensor.as_deref().unwrap_or_default();
        return Err(invalid!(file, "inputs"; found "{}", described(&inputs);
            expected "{expected:?}, as {} says", contract.file.display(); help "{OTHER}"));
    }
    let expected = contract.input_shape();
    let declared = shape(input);
    let fits = declared.as_ref().is_none_or(|declared| {
        let same = |(found, expected): (&Option<i64>, &usize)| {
            found.is_none_or(|found| found == *expected as i64)
        };
        declared.len() == expected.len() && declared.iter().zip(&expected).all(same)
    });
    if fits {
        return Ok(());
    }
    Err(
        invalid!(file, "tensor {}", input.name; found "shape {}", shape_text(declared.as_deref());
        expected "{expected:?}, as {} says", contract.file.display(); help "{OTHER}"),
    )
}

/// Makes the named output, or the only one, the network's only output; returns its name.
fn choose_output(file: &Path, graph: &mut GraphProto, name: Option<&str>) -> Result<String> {
    let outputs: Vec<&ValueInfoProto> = graph.output.iter().collect();
    let name = match (name, &outputs[..]) {
        (Some(name), _) if outputs.iter().any(|output| output.name == name) => name.to_owned(),
        (None, [output]) => output.name.clone(),
        (name, _) => {
            let expected = name.map_or(
                "one output, or its name in the contract".to_owned(),
                |name| format!("{name:?}"),
            );
            return Err(
                invalid!(file, "outputs"; found "{}", described(&outputs); expected "{expected}"; help "{OTHER}"),
            );
        }
    };
    // The library takes this for granted.
    let made = graph.node.iter().flat_map(|node| &node.output);
    let given = graph.input.iter().map(|input| &input.name);
    if !made.chain(given).any(|made| *made == name) {
        return Err(
            invalid!(file, "tensor {name}"; found "no operator that makes it"; expected "an output of the graph"; help "{OTHER}"),
        );
    }
    graph.output.retain(|output| output.name == name);
    graph.output.truncate(1);
    Ok(name)
}

/// Names and shapes of inputs or outputs.
fn described(all: &[&ValueInfoProto]) -> String {
    let each = all
        .iter()
        .map(|one| format!("{} {}", one.name, shape_text(shape(one).as_deref())));
    let text = each.collect::<Vec<_>>().join(", ");
    if text.is_empty() {
        "none".to_owned()
    } else {
        text
    }
}

/// The declared dimensions; `None` for those that are open.
fn shape(value: &ValueInfoProto) -> Option<Vec<Option<i64>>> {
    let type_proto::Value::TensorType(tensor) = value.r#type.as_ref()?.value.as_ref()?;
    let side = |side: &tensor_shape_proto::Dimension| match side.value {
        Some(tensor_shape_proto::dimension::Value::DimValue(side)) if side >= 0 => Some(side),
        _ => None,
    };
    Some(tensor.shape.as_ref()?.dim.iter().map(side).collect())
}

fn shape_text(shape: Option<&[Option<i64>]>) -> String {
    let side = |side: &Option<i64>| side.map_or("?".to_owned(), |side| side.to_string());
    shape.map_or("of open shape".to_owned(), |shape| {
        format!(
            "[{}]",
            shape.iter().map(side).collect::<Vec<_>>().join(", ")
        )
    })
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
            if volume > LARGEST {
                return Err(Error::Limit {
                    what: format!(
                        "{}: values of tensor {} of shape {shape:?}",
                        file.display(),
                        node.name
                    ),
                    found: volume.to_string(),
                    limit: LARGEST.to_string(),
                    help: "use a smaller network or a smaller input".into(),
                });
            }
        }
    }
    Ok(())
}

fn check_output(file: &Path, model: &TypedModel, name: &str, contract: &Contract) -> Result<()> {
    let fact = guarded(file, || model.output_fact(0).cloned())?;
    let expected = contract.output_shape();
    if fact.datum_type == f32::datum_type()
        && fact
            .shape
            .as_concrete()
            .is_some_and(|shape| shape == expected)
    {
        return Ok(());
    }
    Err(wrong_output(
        file,
        name,
        format!("{:?} {:?}", fact.datum_type, fact.shape),
        contract,
    ))
}

fn wrong_output(file: &Path, name: &str, found: String, contract: &Contract) -> Error {
    let [width, height] = contract.input.size;
    invalid!(file, "tensor {name}"; found "{found}";
        expected "F32 {:?}: {} classes and stride {} for an input of {width}x{height}, as {} says",
            contract.output_shape(), contract.classes.names.len(), contract.output.stride, contract.file.display();
        help "{OTHER}")
}
