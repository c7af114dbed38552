//! The graph of an ONNX file, checked before the library sees it.

use super::contract::{Contract, nearest_first};
use crate::error::{Error, Result, bail, ensure, invalid};
use std::collections::HashSet;
use std::path::Path;
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto};
use tract_onnx::pb::{tensor_proto, tensor_shape_proto, type_proto};
use tract_onnx::prelude::{DatumType, Framework};

/// The domains of the standard operators.
const DOMAINS: [&str; 2] = ["", "ai.onnx"];
/// Names of tensors that an error lists.
const MAX_LISTED: usize = 12;
/// What to do about a network that does not fit.
pub(super) const UNFIT_HELP: &str =
    "choose the contract of this network (--contract), or export the network again";

pub(super) fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn not_onnx(file: &Path, found: &str) -> Error {
    invalid!(file, "model"; found "{found}"; expected "an ONNX network"; help "copy or export it again")
}

/// The network in `bytes` with one output: `tensor`, which may be any tensor within it, or the contract's. The second value is
/// the output's name.
///
/// # Errors
/// [`Error::Input`] for bytes that are not ONNX, weights that lie in other files or do not fill their shapes, operators that the
/// library lacks or that are of no standard domain, and an input or output of a different name, type or shape than the contract says.
pub(super) fn read(
    file: &Path,
    bytes: &[u8],
    contract: &Contract,
    tensor: Option<&str>,
) -> Result<(ModelProto, String)> {
    let mut proto = decode(file, bytes)?;
    let graph = proto.graph.as_mut();
    let graph = graph.ok_or_else(|| not_onnx(file, "a file without a graph"))?;
    check_parts(file, graph)?;
    check_input(file, graph, contract)?;
    tensor.map_or(Ok(()), |tensor| expose(file, graph, tensor))?;
    let name = tensor.or(contract.output.tensor.as_deref());
    let output = choose_output(file, graph, name)?;
    Ok((proto, output))
}

fn decode(file: &Path, bytes: &[u8]) -> Result<ModelProto> {
    if let Some(kind) = crate::files::kind(bytes) {
        return Err(not_onnx(file, kind));
    }
    let proto = tract_onnx::onnx().proto_model_for_read(&mut &*bytes);
    proto.map_err(|e| {
        let count = bytes.len();
        let cause = one_line(&format!("{e:#}"));
        let found = format!("{count} bytes that are damaged or cut off ({cause})");
        not_onnx(file, &found)
    })
}

/// Checks weights and operators of a graph, and of the graphs within its operators.
fn check_parts(file: &Path, graph: &GraphProto) -> Result<()> {
    let attributes = || graph.node.iter().flat_map(|node| &node.attribute);
    let constants = attributes().flat_map(|attribute| attribute.t.iter().chain(&attribute.tensors));
    let mut weights = graph.initializer.iter().chain(constants);
    weights.try_for_each(|weights| check_weights(file, weights))?;
    check_operators(file, graph)?;
    let mut bodies = attributes().flat_map(|attribute| attribute.g.iter().chain(&attribute.graphs));
    bodies.try_for_each(|body| check_parts(file, body))
}

/// Refuses weights that do not fill their shape.
fn check_weights(file: &Path, weights: &TensorProto) -> Result<()> {
    let name = &weights.name;
    ensure!(weights.data_location != Some(tensor_proto::DataLocation::External as i32),
        file, "tensor {name}"; found "weights in another file"; expected "weights in this file";
        help "save the network as one file; in Python: onnx.save(onnx.load(path), path)");
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
    let kind = tensor_proto::DataType::try_from(weights.data_type).ok();
    let kind = kind.and_then(|kind| DatumType::try_from(kind).ok());
    let fits = volume.is_some_and(|volume| {
        if raw > 0 {
            // Types that the library does not know are refused there.
            kind.is_none_or(|kind| Some(raw) == volume.checked_mul(kind.size_of() as u128))
        } else {
            volume == stored.iter().map(|n| *n as u128).sum::<u128>()
        }
    });
    ensure!(fits,
        file, "tensor {name}"; found "shape {shape:?} with {raw} bytes, {} numbers", stored.iter().sum::<usize>();
        expected "as many values as the shape has"; help "copy or export the network again");
    Ok(())
}

fn check_operators(file: &Path, graph: &GraphProto) -> Result<()> {
    let known = tract_onnx::onnx().op_register.0;
    // The library does not read the domain: an operator of another one would run as the standard one of its name.
    let is_foreign = |node: &&NodeProto| !DOMAINS.contains(&&*node.domain);
    if let Some(node) = graph.node.iter().find(is_foreign) {
        bail!(file, "operator {:?}", node.name; found "{:?} of the domain {:?}", node.op_type, node.domain;
            expected "an operator of ONNX itself, of the domain \"\" or \"ai.onnx\"";
            help "export the network with standard operators");
    }
    let is_unknown = |node: &&NodeProto| !known.contains_key(&node.op_type);
    if let Some(node) = graph.node.iter().find(is_unknown) {
        bail!(file, "operator {:?}", node.name; found "{:?}", node.op_type; expected "an operator that tract implements";
            help "export the network with other operators or another opset");
    }
    Ok(())
}

/// Refuses a network whose inputs are not the one of the contract.
fn check_input(file: &Path, graph: &GraphProto, contract: &Contract) -> Result<()> {
    let weights = graph.initializer.iter();
    let weights: HashSet<&str> = weights.map(|weights| &*weights.name).collect();
    let is_input = |input: &&ValueInfoProto| !weights.contains(&*input.name);
    let inputs: Vec<&ValueInfoProto> = graph.input.iter().filter(is_input).collect();
    let [input] = inputs[..] else {
        bail!(file, "inputs"; found "{}", described(&inputs); expected "one input"; help "{UNFIT_HELP}");
    };
    let named = contract.input.tensor.as_ref();
    if let Some(expected) = named.filter(|name| **name != input.name) {
        bail!(file, "inputs"; found "{}", described(&inputs);
            expected "{expected:?}, as {} says", contract.file.display(); help "{UNFIT_HELP}");
    }
    let kind = kind(input).filter(|kind| *kind != tensor_proto::DataType::Undefined);
    if let Some(other) = kind.filter(|kind| *kind != tensor_proto::DataType::Float) {
        bail!(file, "tensor {}", input.name; found "values of type {}", other.as_str_name().to_lowercase();
            expected "float32"; help "export the network with an input of float32");
    }
    let expected = contract.input_shape();
    let declared = shape(input);
    let fits = declared.as_ref().is_none_or(|declared| {
        let same = |(found, expected): (&Option<i64>, &usize)| {
            found.is_none_or(|found| found == *expected as i64)
        };
        declared.len() == expected.len() && declared.iter().zip(&expected).all(same)
    });
    ensure!(fits, file, "tensor {}", input.name; found "shape {}", shape_text(declared.as_deref());
        expected "{expected:?}, as {} says", contract.file.display(); help "{UNFIT_HELP}");
    Ok(())
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
            bail!(file, "outputs"; found "{}", described(&outputs); expected "{expected}"; help "{UNFIT_HELP}");
        }
    };
    // The ONNX library does not check this.
    let made = graph.node.iter().flat_map(|node| &node.output);
    let inputs = graph.input.iter().map(|input| &input.name);
    ensure!(made.chain(inputs).any(|made| *made == name),
        file, "tensor {name}"; found "no operator that makes it"; expected "an output of the graph"; help "{UNFIT_HELP}");
    graph.output.retain(|output| output.name == name);
    graph.output.truncate(1);
    Ok(name)
}

/// Names and shapes of inputs or outputs.
fn described(all: &[&ValueInfoProto]) -> String {
    if all.is_empty() {
        return "none".to_owned();
    }
    let each = all
        .iter()
        .map(|one| format!("{} {}", one.name, shape_text(shape(one).as_deref())));
    each.collect::<Vec<_>>().join(", ")
}

/// The declared type of the values; `None` where none that ONNX knows is declared.
fn kind(value: &ValueInfoProto) -> Option<tensor_proto::DataType> {
    let type_proto::Value::TensorType(tensor) = value.r#type.as_ref()?.value.as_ref()?;
    tensor_proto::DataType::try_from(tensor.elem_type).ok()
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
        let sides: Vec<String> = shape.iter().map(side).collect();
        format!("[{}]", sides.join(", "))
    })
}

/// Makes a tensor within the graph one of its outputs.
fn expose(file: &Path, graph: &mut GraphProto, tensor: &str) -> Result<()> {
    let made = graph.node.iter().flat_map(|node| &node.output);
    let made: Vec<&str> = made.map(String::as_str).collect();
    if !made.contains(&tensor) {
        let nearest = nearest_first(tensor, made.into_iter());
        let nearest = nearest[..nearest.len().min(MAX_LISTED)].join(", ");
        bail!(file, "tensor"; found "{tensor:?}"; expected "a tensor of the network, such as {nearest}";
            help "correct the name");
    }
    graph.output.push(ValueInfoProto {
        name: tensor.to_owned(),
        ..ValueInfoProto::default()
    });
    Ok(())
}
