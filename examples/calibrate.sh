#!/bin/sh
# Calibrate a rig from board views (first the camera, then the light planes), and evaluate it.
#
#   sh examples/calibrate.sh [output folder]
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
boards=$here/../tests/data/calib_b
data=$here/../tests/data/rig_b
out=${1:-calibrate}
mkdir -p "$out"

ringpose calibrate-camera "$boards/camera" --board "$boards/camera_board.yaml" --camera-name rig_b \
    --output "$out/camera.yaml" --force
ringpose calibrate-planes "$boards/planes" --board "$boards/plane_board.yaml" --camera "$out/camera.yaml" \
    --laser-order right,middle,left --output "$out/rig.yaml" --force

echo "Poses with this rig, and with the true one:"
ringpose bench "$data" --method ml --by rig --rig "$out/rig.yaml" --max-grasp-mm 1
ringpose bench "$data" --method ml --by rig
