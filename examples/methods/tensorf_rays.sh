#!/usr/bin/env bash
# TensoRF of nerfstudio along the rays in the water: tensorf_rays.sh DATASET OUTPUT [--central]
# Once before: tensorf_rays.sh install (in the folder $TENSORF_RAYS, by default ~/.cache/rhizotwin_tensorf_rays)
set -euo pipefail
environment=${TENSORF_RAYS:-$HOME/.cache/rhizotwin_tensorf_rays}
if [ "$1" = install ]; then
    python3 -m venv "$environment"
    "$environment/bin/pip" install torch==2.13.0 numpy==2.4.6 pillow==13.0.0 nerfacc==0.5.2 jaxtyping==0.3.11 msgspec==0.22.0 websockets==17.4 \
        zstandard==0.25.0 rich==15.0.0
    exec "$environment/bin/pip" install --no-deps nerfstudio==1.1.5 viser==1.1.1 # only few of their dependencies are used
fi
dataset=$1 output=$2 working=$(mktemp -d)
trap 'rm -rf "$working"' EXIT
rhizotwin reconstruct "$dataset" -o "$working/hull" --method hull --quiet # for its cameras
rhizotwin export "$working/hull" --dataset "$dataset" --rays -o "$working/rays" --quiet
"$environment/bin/python" "$(dirname "$0")/tensorf_rays.py" "$working/rays" "$dataset/masks" "$output" "${@:3}"
