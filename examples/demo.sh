#!/bin/sh
# The demonstration: a pose graph with exact ground truth, compacted by the three strategies, compared in one table; then
# a rendered stereo sequence of a street driven twice, from images to a compact map.
set -eu
terse=$(dirname "$0")/../build/bin/terse
out=${1:-demo_output}
mkdir -p "$out"

"$terse" generate ellipse --seed 1 --output "$out/ellipse.g2o" --ground-truth "$out/ground_truth.tum"
printf '\n170 poses on two ellipses, 5 %% error in translation and rotation; errors against the ground truth (root mean square)\n\n'
printf '%-9s %6s %6s %9s %10s %10s %10s %10s\n' strategy poses links 'time [s]' 'ATE [m]' 'ATE [deg]' 'RPE [m]' 'RPE [deg]'
for strategy in apal apfl fpfl; do
  "$terse" compact "$out/ellipse.g2o" --strategy $strategy --output "$out/$strategy" --quiet
  "$terse" evaluate "$out/$strategy/trajectory.tum" "$out/ground_truth.tum" --json > "$out/$strategy/evaluation.json"
  # The files are our own, one key a line.
  value() { sed -n "s/^ *\"$2\": \([^,]*\),\{0,1\}$/\1/p" "$1" | sed -n "${3}p"; }
  stats=$out/$strategy/stats.json
  errors=$out/$strategy/evaluation.json
  printf '%-9s %6d %6d %9.3f %10.4f %10.4f %10.4f %10.4f\n' $strategy \
    "$(value "$stats" poses_kept 1)" "$(value "$stats" links_kept 1)" "$(value "$stats" total 1)" \
    "$(value "$errors" translation_m 1)" "$(value "$errors" rotation_deg 1)" \
    "$(value "$errors" translation_m 2)" "$(value "$errors" rotation_deg 2)"
done
cat <<END

apal keeps all poses and all links (loops beside the odometry), apfl all poses and the links that carry information,
fpfl few of both. One run of one data set: which ATE is the smallest is chance, that they are alike is not.
Data and ground truth: $out/ellipse.g2o, $out/ground_truth.tum
Results, each in $out/apal, $out/apfl and $out/fpfl: compact.g2o (the map), trajectory.tum (all poses), decisions.csv, covariances.csv,
stats.json, evaluation.json
END

# Without OpenCV the command has no front end.
"$terse" generate stereo --help >/dev/null 2>&1 || exit 0

printf '\nA street driven twice by a stereo camera, 400 frames\n\n'
rm -rf "$out/street"
"$terse" generate stereo --laps 2 --frames 400 --size 920x278 --seed 1 --output "$out/street"
"$terse" kitti "$out/street" --ground-truth "$out/street/poses.txt" --output "$out/street_fpfl"
cat <<END

Images, calibration and ground truth, as KITTI has them: $out/street
Results: $out/street_fpfl, trajectory.kitti.txt and trajectory.tum (all frames), compact.g2o (the map), covariances.csv, loops.csv,
stats.json
END
