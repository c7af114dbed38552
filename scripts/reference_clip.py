#!/usr/bin/env python3
"""Makes tests/fixtures/clip.safetensors: token ids and text embeddings by Hugging Face transformers, in f64.

    pip install torch transformers ftfy safetensors pillow          4.46.3 with PyTorch 1.13.1 made the fixture; no GPU needed
    python3 scripts/reference_clip.py fixture bpe_simple_vocab_16e6.txt.gz tests/fixtures/clip.safetensors
    python3 scripts/reference_clip.py weights clip.safetensors      the weights of the case "base" as a file of 254 MB
    python3 scripts/reference_clip.py maps bpe_simple_vocab_16e6.txt.gz SCENE OUT     maps by these weights, made up from true labels

The vocabulary is of github.com/openai/CLIP, folder clip. No published weights are read.
Weights are hashes of tensor names and places, which tests/suite/support/clip_weights.rs makes
anew, so the fixture holds results alone. "base" has the shape of the text encoder of ViT-B/32.
"""
import argparse
import gzip
import json
import tempfile
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

# vocabulary, width, hidden, blocks, positions, projection
SIZES = {"small": (600, 128, 96, 2, 16, 24), "base": (49408, 512, 2048, 12, 77, 512)}
TEXTS = [
    "a red chair",
    "A photo of a cat.",
    "the painter's 2 brushes don't cost $3.50, they've said!!",
    "une cafetière électrique près de la fenêtre",
    "things",
    "日本語 ☕",
]


def shapes(size):
    """Names and shapes of the tensors, as Hugging Face has them."""
    vocabulary, width, hidden, blocks, positions, projection = size
    yield "text_model.embeddings.token_embedding.weight", (vocabulary, width)
    yield "text_model.embeddings.position_embedding.weight", (positions, width)
    layers = []
    for n in range(blocks):
        block = f"text_model.encoder.layers.{n}."
        layers += [(f"{block}self_attn.{part}", (width, width)) for part in ("q_proj", "k_proj", "v_proj", "out_proj")]
        layers += [(f"{block}{part}", (width,)) for part in ("layer_norm1", "layer_norm2")]
        layers += [(f"{block}mlp.fc1", (hidden, width)), (f"{block}mlp.fc2", (width, hidden))]
    layers.append(("text_model.final_layer_norm", (width,)))
    for name, shape in layers:
        yield f"{name}.weight", shape
        yield f"{name}.bias", shape[:1]
    yield "text_projection.weight", (projection, width)


def values(name, shape):
    """Uniform values by SplitMix64 of the name's FNV-1a hash and the place; of the size of trained ones."""
    seed = 0xCBF29CE484222325
    for byte in name.encode():
        seed = (seed ^ byte) * 0x100000001B3 % 2**64
    count = int(np.prod(shape))
    with np.errstate(over="ignore"):
        z = np.uint64(seed) + np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    uniform = (z >> np.uint64(40)).astype(np.float32) / np.float32(2**23) - np.float32(1)
    mean, spread = 0.0, 0.1
    if "norm" in name and name.endswith("weight"):
        mean, spread = 1.0, 0.3
    elif len(shape) == 2 and "embedding" not in name:
        spread = 2.0 / np.sqrt(np.float64(shape[1]))
    return (np.float32(mean) + np.float32(spread) * uniform).reshape(shape)


def tokenizer(vocabulary):
    """Hugging Face's tokenizer over OpenAI's vocabulary."""
    from transformers import CLIPTokenizer

    merges = gzip.decompress(Path(vocabulary).read_bytes()).decode().split("\n")[1 : 49152 - 256 - 2 + 1]
    from transformers.models.clip.tokenization_clip import bytes_to_unicode

    letters = list(bytes_to_unicode().values())
    words = letters + [letter + "</w>" for letter in letters] + ["".join(merge.split()) for merge in merges]
    words += ["<|startoftext|>", "<|endoftext|>"]
    folder = Path(tempfile.mkdtemp())
    (folder / "vocab.json").write_text(json.dumps({word: place for place, word in enumerate(words)}))
    (folder / "merges.txt").write_text("\n".join(["#version: 0.2", *merges]), encoding="utf8")
    return CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"))


def embeddings(size, activation, rows):
    """Embeddings of the token lists `rows`, padded as the published tokenizer pads them."""
    import torch
    from transformers import CLIPTextConfig, CLIPTextModelWithProjection

    torch.set_default_dtype(torch.float64)
    vocabulary, width, hidden, blocks, positions, projection = size
    config = CLIPTextConfig(
        vocab_size=vocabulary, hidden_size=width, intermediate_size=hidden, num_hidden_layers=blocks,
        num_attention_heads=width // 64, max_position_embeddings=positions, projection_dim=projection,
        hidden_act=activation, bos_token_id=vocabulary - 2, eos_token_id=vocabulary - 1, pad_token_id=vocabulary - 1)
    model = CLIPTextModelWithProjection(config).eval()
    state = {name: torch.from_numpy(values(name, shape)).double() for name, shape in shapes(size)}
    missing, unexpected = model.load_state_dict(state, strict=False)
    assert not unexpected and all("position_ids" in name for name in missing), (missing, unexpected)
    padded = torch.tensor([row + [vocabulary - 1] * (positions - len(row)) for row in rows])
    with torch.no_grad():
        return model(input_ids=padded).text_embeds.numpy()


def fixture(vocabulary, path):
    tensors = {}
    words = tokenizer(vocabulary)
    rows = {"base": [words(text)["input_ids"] for text in TEXTS]}
    rng = np.random.default_rng(0)
    rows["small"] = [[598, *map(int, rng.integers(0, 598, length)), 599] for length in (0, 1, 3, 7, 14)]
    for number, (text, row) in enumerate(zip(TEXTS, rows["base"])):
        print(text, row)
        tensors[f"text.{number}"] = np.frombuffer(text.encode(), np.uint8)
    for name, size in SIZES.items():
        for number, row in enumerate(rows[name]):
            tensors[f"{name}.tokens.{number}"] = np.array(row, np.uint32)
        for activation in ("quick_gelu", "gelu"):
            tensors[f"{name}.{activation}"] = embeddings(size, activation, rows[name]).astype(np.float32)
    save_file(tensors, path)


def maps(vocabulary, scene, out):
    """For each photo the embedding of the name of each pixel's class, of length 1, and noise of length 0.45; 160x120 cells, f16."""
    from PIL import Image

    names = {int(number): name for number, name in json.loads((scene / "classes.json").read_text()).items()}
    words = tokenizer(vocabulary)
    rows = [words(names.get(number, "things") if number else "things")["input_ids"] for number in range(max(names) + 1)]
    table = embeddings(SIZES["base"], "quick_gelu", rows).astype(np.float32)
    table /= np.linalg.norm(table, axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    out.mkdir(exist_ok=True)
    for frame in json.loads((scene / "transforms.json").read_text())["frames"]:
        cells = Image.open(scene / frame["label_path"]).resize((160, 120), Image.NEAREST)
        features = table[np.array(cells)]
        features += rng.normal(size=features.shape).astype(np.float32) * np.float32(0.02)
        np.save(out / f"{Path(frame['file_path']).stem}.1.npy", features.astype(np.float16))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["fixture", "weights", "maps"])
    parser.add_argument("files", nargs="+", help="files as above; the last one is written")
    arguments = parser.parse_args()
    out = arguments.files[-1]
    if arguments.what == "fixture":
        fixture(arguments.files[0], out)
    elif arguments.what == "maps":
        maps(arguments.files[0], Path(arguments.files[1]), Path(out))
    else:
        save_file({name: values(name, shape) for name, shape in shapes(SIZES["base"])}, out)


if __name__ == "__main__":
    main()
