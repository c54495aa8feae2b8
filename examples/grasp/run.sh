#!/bin/sh
# Grasps the ring of a tumbling satellite on the platform:
# sh run.sh DIR [--seed N] [--floating] [--distance-m D] [--share S] [--record]
set -e
here=$(dirname "$0") dir=$1
shift
python3 "$here/grasp.py" prepare "$dir" "$@"
rm -f "$dir/robot" "$dir/address"
mkfifo "$dir/robot"
ringpose simulate serve --images tcp://127.0.0.1:0 --clock lockstep --rate 16 "$dir/scene.yaml" > "$dir/address" &
platform=$!
trap 'kill $platform 2> /dev/null; rm -f "$dir/robot"' EXIT
until test -s "$dir/address"; do sleep 0.2; done
address=$(sed 's/.*"camera": "\([^"]*\)".*/\1/' "$dir/address")
ringpose pose --track --rig "$dir/rig.yaml" --camera "$address" --sequence off,all --robot-poses - --json \
    < "$dir/robot" |
    python3 "$here/grasp.py" run "$dir" "$address" "$@" > "$dir/robot"
