#!/usr/bin/env bash
# of_runs.sh TERSE FOLDER RUN...: reports of real runs, in 3D and 2D, of one pose and of two runs, checked by RUN (run.sh).
set -euo pipefail
terse=$1 folder=$2
shift 2
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
"$terse" generate ellipse --seed 2 --output ellipse.g2o --ground-truth ellipse.tum
"$terse" compact ellipse.g2o --strategy apal --output apal --quiet
"$terse" compact ellipse.g2o --ground-truth ellipse.tum --output fpfl --quiet
"$terse" generate manhattan --poses 300 --seed 2 --output plane.g2o
"$terse" compact plane.g2o --output plane --quiet
echo "VERTEX_SE2 0 0 0 0" >one.g2o
"$terse" compact one.g2o --strategy apal --output one --quiet
"$terse" generate ellipse-n --laps 2 --seed 2 --output laps.g2o
"$terse" compact laps.g2o --strategy bounded --output bounded --quiet
"$terse" report apal fpfl --quiet
exec "$@" "$folder"/{fpfl,plane,one,bounded}/report.html "$folder/apal/comparison.html"
