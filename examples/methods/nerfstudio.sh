#!/usr/bin/env bash
# Mesh of a NeRF with nerfstudio: nerfstudio.sh DATASET OUTPUT (requires nerfstudio and a GPU)
set -euo pipefail
dataset=$1/undistorted output=$2 working=$(mktemp -d)
trap 'rm -rf "$working"' EXIT
ns-train nerfacto --data "$dataset" --output-dir "$working" --max-num-iterations 20000 --viewer.quit-on-train-completion True \
    --pipeline.model.background-color white nerfstudio-data --orientation-method none --center-method none --auto-scale-poses False
config=$(find "$working" -name config.yml)
mkdir -p "$output"
ns-export poisson --load-config "$config" --output-dir "$working/mesh" --normal-method open3d \
    --obb-center 0 0 -70 --obb-rotation 0 0 0 --obb-scale 146 146 140
cp "$working"/mesh/poisson_mesh.ply "$output/shape.ply"
