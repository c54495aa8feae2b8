#!/bin/sh
# From shots to poses to a robot's controller, in one line, on shots that ringpose did not make.
#
#   sh examples/real-shots.sh [folder for what is written]
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
data=$here/../tests/data/rig_b
out=${1:-real-shots}
mkdir -p "$out"

echo "What the controller hears:"
ringpose capture --camera "files:$data/shots" --output "$out/session" --force |
    ringpose detect - --rig "$data/rig.yaml" --overlay "$out/overlay" --force |
    ringpose pose - --rig "$data/rig.yaml" |
    tee "$out/poses.jsonl" |
    python3 "$here/controller.py" --replay

echo
echo "How far it is from the truth:"
ringpose bench "$out/poses.jsonl" --truth "$data/truth.jsonl" --max-missed 0 --max-grasp-mm 1

echo
echo "Where the stripes end: $out/overlay"
