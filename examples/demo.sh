#!/bin/sh
# The main job on simulated shots: board views -> calibration, shots -> break points -> poses, errors against truth.
#
#   sh examples/demo.sh [output folder]
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
out=${1:-demo}
sim=$out/simulated
mkdir -p "$out"

say() { printf '\n== %s\n' "$1"; }

say "A scene is simulated: shots of a ring at three distances, and views of two calibration boards"
ringpose simulate "$here/scene.yaml" --output "$sim" --force

say "The camera is calibrated from the views of a ChArUco board"
ringpose calibrate-camera "$sim/calibration/camera" --board "$sim/calibration/camera_board.yaml" \
    --output "$out/camera.yaml" --force

say "The light planes are calibrated from the stripes on a four-marker board"
ringpose calibrate-planes "$sim/calibration/planes" --board "$sim/calibration/plane_board.yaml" \
    --camera "$out/camera.yaml" --output "$out/rig.yaml" --force

say "Shots become poses while they are taken: capture | detect | pose"
ringpose capture --camera "files:$sim/shots" --output "$out/session" --force |
    ringpose detect - --rig "$out/rig.yaml" --overlay "$out/overlay" --force |
    ringpose pose - --rig "$out/rig.yaml" |
    tee "$out/poses.jsonl" |
    python3 "$here/controller.py" --replay

say "The poses are compared with the truth"
ringpose bench "$out/poses.jsonl" --truth "$sim/truth.jsonl" --by distance_m

say "What is left to look at"
echo "$out/overlay         stripes and break points, drawn into the shots"
echo "$out/poses.jsonl     one pose a line"
echo "$out/rig.yaml        the calibrated rig; the true one is $sim/rig.yaml"
