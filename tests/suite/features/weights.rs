//! Weight files: PyTorch and safetensors, whole, broken, and not what was asked for.

use base64::Engine;
use coseg::Error;
use coseg::config::{Config, SpatialConfig, SpatialScale, SpatialSource};
use coseg::data::WorldUnit;
use coseg::segmentation::encoder::{load_spatial, metres_per_unit, random_weights};
use coseg::segmentation::randla::RandlaEncoder;
use coseg::weights::{HostTensor, WeightFile};
use std::path::PathBuf;

/// What `torch.save` writes for `{"epoch": 3, "model_state_dict": {"module.fc0.conv.weight": [2, 3, 1] of 1, 2, 3, 4, 5, 6.5,
/// "module.fc0.bn.bn.num_batches_tracked": 7}}`.
const PYTORCH: &str = concat!(
    "UEsDBBQAAAAAAAAAIQDEZTz7VAEAAFQBAAAQAAAAYXJjaGl2ZS9kYXRhLnBrbIACfXEAKFgFAAAAZXBvY2hxAUsDWBAAAABtb2RlbF9zdGF0ZV",
    "9kaWN0cQJjY29sbGVjdGlvbnMKT3JkZXJlZERpY3QKcQMpUnEEKFgWAAAAbW9kdWxlLmZjMC5jb252LndlaWdodHEFY3RvcmNoLl91dGlscwpf",
    "cmVidWlsZF90ZW5zb3JfdjIKcQYoKFgHAAAAc3RvcmFnZXEHY3RvcmNoCkZsb2F0U3RvcmFnZQpxCFgBAAAAMHEJWAMAAABjcHVxCksGdHELUU",
    "sASwJLA0sBh3EMSwNLAUsBh3ENiWgDKVJxDnRxD1JxEFgkAAAAbW9kdWxlLmZjMC5ibi5ibi5udW1fYmF0Y2hlc190cmFja2VkcRFoBigoaAdj",
    "dG9yY2gKTG9uZ1N0b3JhZ2UKcRJYAQAAADFxE2gKSwF0cRRRSwApKYloAylScRV0cRZScRd1dS5QSwMEFAAAAAAAAAAhAIU94xkGAAAABgAAAB",
    "EAAABhcmNoaXZlL2J5dGVvcmRlcmxpdHRsZVBLAwQUAAAAAAAAACEAdff7UxgAAAAYAAAADgAAAGFyY2hpdmUvZGF0YS8wAACAPwAAAEAAAEBA",
    "AACAQAAAoEAAANBAUEsDBBQAAAAAAAAAIQBw1udvCAAAAAgAAAAOAAAAYXJjaGl2ZS9kYXRhLzEHAAAAAAAAAFBLAwQUAAAAAAAAACEA0Z5nVQ",
    "IAAAACAAAADwAAAGFyY2hpdmUvdmVyc2lvbjMKUEsBAhQDFAAAAAAAAAAhAMRlPPtUAQAAVAEAABAAAAAAAAAAAAAAAIABAAAAAGFyY2hpdmUv",
    "ZGF0YS5wa2xQSwECFAMUAAAAAAAAACEAhT3jGQYAAAAGAAAAEQAAAAAAAAAAAAAAgAGCAQAAYXJjaGl2ZS9ieXRlb3JkZXJQSwECFAMUAAAAAA",
    "AAACEAdff7UxgAAAAYAAAADgAAAAAAAAAAAAAAgAG3AQAAYXJjaGl2ZS9kYXRhLzBQSwECFAMUAAAAAAAAACEAcNbnbwgAAAAIAAAADgAAAAAA",
    "AAAAAAAAgAH7AQAAYXJjaGl2ZS9kYXRhLzFQSwECFAMUAAAAAAAAACEA0Z5nVQIAAAACAAAADwAAAAAAAAAAAAAAgAEvAgAAYXJjaGl2ZS92ZX",
    "JzaW9uUEsFBgAAAAAFAAUAMgEAAF4CAAAAAA==",
);

fn pytorch_file(dir: &tempfile::TempDir, length: usize) -> PathBuf {
    let bytes = base64::engine::general_purpose::STANDARD
        .decode(PYTORCH)
        .expect("base64");
    let path = dir.path().join("weights.pth");
    std::fs::write(&path, &bytes[..length.min(bytes.len())]).expect("a writable folder");
    path
}

#[test]
fn reads_nested_data_parallel_pytorch_checkpoints() {
    let dir = tempfile::tempdir().expect("a folder");
    let weights = WeightFile::open(pytorch_file(&dir, usize::MAX)).expect("a PyTorch file");
    assert_eq!(
        weights.tensors.keys().collect::<Vec<_>>(),
        ["fc0.conv.weight"]
    );
    let want = HostTensor {
        shape: vec![2, 3, 1],
        values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.5],
    };
    assert_eq!(weights.tensors["fc0.conv.weight"], want);
    assert_eq!(
        weights
            .get("fc0.conv.weight", &[2, 3])
            .expect("a 1x1 convolution"),
        want.values
    );
}

#[test]
fn truncated_files_are_named_and_never_panic() {
    let dir = tempfile::tempdir().expect("a folder");
    for length in (0..900).step_by(50) {
        let found = WeightFile::open(pytorch_file(&dir, length));
        assert!(
            matches!(&found, Err(Error::Input { path, .. }) if path.ends_with("weights.pth")),
            "{length}: {found:?}"
        );
    }
    let bytes = random_weights(3, 0)
        .to_safetensors()
        .expect("whole tensors");
    let path = dir.path().join("weights.safetensors");
    for length in [0, 7, 8, 100, 5_000, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).expect("a writable folder");
        let found = WeightFile::open(&path);
        assert!(
            matches!(&found, Err(Error::Input { path: p, .. }) if *p == path),
            "{length}: {found:?}"
        );
    }
    let missing = WeightFile::open(dir.path().join("none.safetensors"));
    assert!(matches!(missing, Err(Error::Io { .. })), "{missing:?}");
    let missing = WeightFile::open(dir.path().join("none.pth"));
    assert!(matches!(missing, Err(Error::Io { .. })), "{missing:?}");
}

#[test]
fn every_missing_misshapen_or_non_finite_tensor_is_named() {
    let device = crate::support::device();
    let whole = random_weights(3, 0);
    let field = |weights: &WeightFile| match RandlaEncoder::load(weights, &device) {
        Err(Error::Input { field, .. }) => field,
        other => panic!("{:?}", other.map(|e| e.widths())),
    };
    for name in whole.tensors.keys() {
        let mut weights = whole.clone();
        weights.tensors.remove(name);
        assert_eq!(&field(&weights), name);
        let mut weights = whole.clone();
        weights.insert(
            name,
            HostTensor {
                shape: vec![7, 9],
                values: vec![0.0; 63],
            },
        );
        // a width taken from a misshapen tensor may first clash elsewhere in its block
        assert!(!field(&weights).is_empty());
        let mut weights = whole.clone();
        if let Some(tensor) = weights.tensors.get_mut(name) {
            tensor.values[0] = f32::NAN;
        }
        assert_eq!(&field(&weights), name);
    }
}

#[test]
fn stored_again_an_encoder_is_the_same() {
    let device = crate::support::device();
    let weights = random_weights(6, 4);
    let encoder = RandlaEncoder::load(&weights, &device).expect("weights");
    assert_eq!(encoder.inputs(), 6);
    let stored = encoder.to_weight_file("random RandLA weights");
    assert_eq!(stored.expect("readable"), weights);
}

#[test]
fn settings_choose_the_weights_and_unusable_ones_are_refused() {
    let device = crate::support::device();
    let config = SpatialConfig {
        source: SpatialSource::Pretrained("/nowhere/weights.pth".into()),
        ..SpatialConfig::default()
    };
    assert!(matches!(
        load_spatial(&config, 0, &device),
        Err(Error::Io { .. })
    ));
    let (_, name) =
        load_spatial(&SpatialConfig::default(), 0, &device).expect("the weights inside this crate");
    assert_eq!(name, "trained here");
}

#[test]
fn the_unit_is_given_or_a_metre_or_follows_from_the_cameras() {
    let auto = |unit| metres_per_unit(SpatialScale::Auto, unit, f64::NAN).ok();
    let set =
        |scale, extent| metres_per_unit(SpatialScale::Metres(scale), WorldUnit::Metre, extent).ok();
    assert_eq!(auto(WorldUnit::Metre), Some(1.0));
    assert_eq!(auto(WorldUnit::Arbitrary { extent: 8.0 }), Some(0.25));
    assert_eq!(set(3.0, f64::NAN), Some(3.0));
    assert_eq!(set(0.0, 8.0), Some(0.25));
    for scale in ["-1", "nan", "inf", "metre"] {
        let set = format!("spatial.scale={scale}");
        let error = Config::load(None, std::slice::from_ref(&set)).unwrap_err();
        assert!(
            error.to_string().contains("spatial.scale"),
            "{set}: {error}"
        );
    }
    for extent in [0.0, f64::INFINITY, f64::NAN] {
        assert_eq!(auto(WorldUnit::Arbitrary { extent }), Some(1.0), "{extent}");
        assert_eq!(set(0.0, extent), None, "{extent}");
    }
}
