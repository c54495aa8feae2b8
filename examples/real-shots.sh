#!/bin/sh
# A pipeline from shots to poses to a robot's controller, on shots that were not made with ringpose.
#
#   sh examples/real-shots.sh [output folder]
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
data=$here/../tests/data/rig_b
out=${1:-real-shots}
mkdir -p "$out"

echo "Commands of the controller:"
ringpose capture --camera "files:$data/shots" --output "$out/session" --force |
    ringpose detect - --rig "$data/rig.yaml" --overlay "$out/overlay" --force |
    ringpose pose - --rig "$data/rig.yaml" |
    tee "$out/poses.jsonl" |
    python3 "$here/controller.py" --replay

echo
echo "Errors against the truth:"
ringpose bench "$out/poses.jsonl" --truth "$data/truth.jsonl" --max-missed 0 --max-grasp-mm 1

echo
echo "Where the stripes end: $out/overlay"
