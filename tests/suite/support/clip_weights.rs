//! Weights of CLIP's text encoder in any size, generated as `scripts/reference_clip.py` does.

use crate::support::dino_weights::Tensors;

/// Dimensions of a network.
#[derive(Clone, Copy)]
pub struct Size {
    pub vocabulary: usize,
    pub width: usize,
    pub hidden: usize,
    pub blocks: usize,
    pub positions: usize,
    pub projection: usize,
}

/// The case `small` of the script.
pub const SMALL: Size = Size {
    vocabulary: 600,
    width: 128,
    hidden: 96,
    blocks: 2,
    positions: 16,
    projection: 24,
};

/// The case `base`: the shape of ViT-B/32.
pub const BASE: Size = Size {
    vocabulary: 49408,
    width: 512,
    hidden: 2048,
    blocks: 12,
    positions: 77,
    projection: 512,
};

/// Tensors with the names and shapes of Hugging Face.
pub fn generated(size: Size) -> Tensors {
    let (width, hidden) = (size.width, size.hidden);
    let embeddings = "text_model.embeddings";
    let mut shapes = vec![
        (
            format!("{embeddings}.token_embedding.weight"),
            vec![size.vocabulary, width],
        ),
        (
            format!("{embeddings}.position_embedding.weight"),
            vec![size.positions, width],
        ),
        (
            "text_projection.weight".to_owned(),
            vec![size.projection, width],
        ),
    ];
    let mut layer = |name: &str, shape: &[usize]| {
        shapes.push((format!("{name}.weight"), shape.to_vec()));
        shapes.push((format!("{name}.bias"), shape[..1].to_vec()));
    };
    for n in 0..size.blocks {
        let block = format!("text_model.encoder.layers.{n}");
        for part in ["q_proj", "k_proj", "v_proj", "out_proj"] {
            layer(&format!("{block}.self_attn.{part}"), &[width, width]);
        }
        layer(&format!("{block}.layer_norm1"), &[width]);
        layer(&format!("{block}.layer_norm2"), &[width]);
        layer(&format!("{block}.mlp.fc1"), &[hidden, width]);
        layer(&format!("{block}.mlp.fc2"), &[width, hidden]);
    }
    layer("text_model.final_layer_norm", &[width]);
    let tensors = shapes.into_iter().map(|(name, shape)| {
        let values = values(&name, &shape);
        (name, (shape, values))
    });
    tensors.collect()
}

/// Uniform values by SplitMix64 of the name's FNV-1a hash and the place.
fn values(name: &str, shape: &[usize]) -> Vec<f32> {
    let seed = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
    });
    let (mean, spread) = match shape {
        _ if name.contains("norm") && name.ends_with("weight") => (1.0, 0.3),
        [_, inputs] if !name.contains("embedding") => (0.0, (2.0 / (*inputs as f64).sqrt()) as f32),
        _ => (0.0, 0.1),
    };
    let value = |place: u64| {
        let z = seed.wrapping_add(place.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let z = z ^ (z >> 31);
        mean + spread * ((z >> 40) as f32 / (1_u64 << 23) as f32 - 1.0)
    };
    (1..=shape.iter().product::<usize>() as u64)
        .map(value)
        .collect()
}

/// The same tensors with the names and shapes of OpenAI.
pub fn as_openai(mut tensors: Tensors) -> Tensors {
    let mut renamed = Tensors::new();
    let (shape, values) = tensors.remove("text_projection.weight").unwrap();
    let (channels, width) = (shape[0], shape[1]);
    let places = (0..width).flat_map(|x| (0..channels).map(move |y| y * width + x));
    let transposed = places.map(|place| values[place]).collect();
    renamed.insert(
        "text_projection".into(),
        (vec![width, channels], transposed),
    );
    for (theirs, openai) in [
        ("embeddings.token_embedding", "token_embedding"),
        (
            "embeddings.position_embedding.weight",
            "positional_embedding",
        ),
        ("final_layer_norm", "ln_final"),
        ("encoder.layers", "transformer.resblocks"),
    ] {
        let theirs = format!("text_model.{theirs}");
        while let Some(name) = tensors
            .keys()
            .find(|name| name.starts_with(&theirs))
            .cloned()
        {
            let (shape, values) = tensors.remove(&name).unwrap();
            let new = name
                .replace(&theirs, openai)
                .replace("layer_norm", "ln_")
                .replace("self_attn", "attn")
                .replace("mlp.fc1", "mlp.c_fc")
                .replace("mlp.fc2", "mlp.c_proj");
            let Some((block, kind)) = new.split_once("k_proj.") else {
                renamed.insert(new, (shape, values));
                continue;
            };
            // Keys come first; queries, keys and values become one tensor.
            let mut part = |letter| tensors.remove(&name.replace("k_proj", letter)).unwrap().1;
            let (queries, of_values) = (part("q_proj"), part("v_proj"));
            let joined = [queries, values, of_values].concat();
            let extents = [&[3 * shape[0]][..], &shape[1..]].concat();
            renamed.insert(format!("{block}in_proj_{kind}"), (extents, joined));
        }
    }
    assert!(tensors.is_empty(), "{:?}", tensors.keys());
    renamed
}
