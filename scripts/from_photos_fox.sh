#!/usr/bin/env bash
# Trains the photos of fox with their given poses and with those that `coseg from-photos` finds, and compares the PSNR of the same test
# photos; then a video that is made from the photos.
#
#     scripts/from_photos_fox.sh COSEG FOX OUT STEPS [OPTION..]       for instance: target/release/coseg fox measured 7000 --seed 1
#
# The options go to each `coseg train`. FOX has images/ and transforms.json, every 8th photo in order being a test photo, as `coseg`
# takes them of a COLMAP model. COSEG_PYTHON names the Python whose pycolmap finds the poses; without it coseg looks by itself.
# ffmpeg makes the video. Finished steps are not repeated; a run that was stopped continues. Exits with 1 where found poses give
# more than 0.3 dB less, or where the test photos differ.
set -euo pipefail
[ $# -ge 4 ] || { sed -n '2,10s/^# \{0,1\}//p' "$0" >&2; exit 2; }
coseg=$1 fox=$2 out=$3 steps=$4
shift 4
options=("$@")
mkdir -p "$out"

# Scene folder of photos or a video: NAME SOURCE [OPTION..]
scene() {
  "$coseg" from-photos "$2" --out "$out/$1" ${COSEG_PYTHON:+--python "$COSEG_PYTHON"} "${@:3}"
}

# Run of a scene folder: NAME FOLDER STEPS
train() {
  local run=$out/run_$1
  if [ -f "$run/metrics.json" ]; then
    return
  elif [ -d "$run/checkpoint" ]; then
    "$coseg" train --resume "$run"
  else
    "$coseg" train --data "$2" --out "$run" --set data.max_side=480 --set 'segmentation.rows=[]' \
      --set building.iterations="$3" "${options[@]}"
  fi
}

scene found "$fox/images"
# Four frames of each photo.
if [ ! -f "$out/fox.mp4" ]; then
  ffmpeg -v error -y -framerate 7.5 -pattern_type glob -i "$fox/images/*.jpg" -r 30 -c:v libx264 -crf 12 -pix_fmt yuv420p -f mp4 "$out/part"
  mv "$out/part" "$out/fox.mp4"
fi
scene filmed "$out/fox.mp4" --frames "$(find "$fox/images" -name '*.jpg' | wc -l)"
train given "$fox" "$steps"
train found "$out/found" "$steps"
train filmed "$out/filmed" 1000

python3 - "$out" <<'END'
import json
import pathlib
import sys

names = ("given", "found", "filmed")
given, found, filmed = (json.loads((pathlib.Path(sys.argv[1]) / f"run_{name}" / "metrics.json").read_text())["test"] for name in names)
if given["views"].keys() != found["views"].keys():
    sys.exit(f"the test photos differ: {sorted(given['views'])} and {sorted(found['views'])}")
difference = found["psnr"] - given["psnr"]
print(f"{len(given['views'])} test photos: given poses {given['psnr']:.2f} dB, found poses {found['psnr']:.2f} dB, {difference:+.2f} dB")
print(f"video: {len(filmed['views'])} test frames, {filmed['psnr']:.2f} dB")
sys.exit(0 if difference >= -0.3 else "found poses give more than 0.3 dB less")
END
