#!/bin/sh
# The demonstration: a pose graph with exact ground truth, compacted by four strategies, compared in one table; then
# a rendered stereo sequence of a street driven twice, from images to a compact map.
set -eu
terse=$(dirname "$0")/../build/bin/terse
out=${1:-demo_output}
mkdir -p "$out"

"$terse" generate ellipse --seed 1 --output "$out/ellipse.g2o" --ground-truth "$out/ground_truth.tum"
printf '\n170 poses on two ellipses, 5 %% error in translation and rotation; errors against the ground truth (root mean square)\n\n'
printf '%-9s %6s %6s %9s %10s %10s %10s %10s\n' strategy poses links 'time [s]' 'ATE [m]' 'ATE [deg]' 'RPE [m]' 'RPE [deg]'
for strategy in apal apfl fpfl bounded; do
  "$terse" compact "$out/ellipse.g2o" --strategy $strategy --ground-truth "$out/ground_truth.tum" --output "$out/$strategy" --quiet
  # The file is our own, one key a line.
  value() { sed -n "s/^ *\"$1\": \([^,]*\),\{0,1\}$/\1/p" "$out/$strategy/stats.json" | head -n 1; }
  printf '%-9s %6d %6d %9.3f %10.4f %10.4f %10.4f %10.4f\n' $strategy \
    "$(value poses_kept)" "$(value links_kept)" "$(value total)" "$(value ate_m)" "$(value ate_deg)" "$(value rpe_m)" \
    "$(value rpe_deg)"
done
cat <<END

apal keeps all poses and all links (loops beside the odometry), apfl all poses and the links that carry information,
fpfl few of both, bounded (the default) no more than the area needs, however often it is passed. One run of one data
set: which ATE is the smallest is chance, that they are alike is not.
Data and ground truth: $out/ellipse.g2o, $out/ground_truth.tum
Results, each in a folder of the strategy's name in $out: compact.g2o (the map), trajectory.tum (all poses), decisions.csv,
covariances.csv, stats.json, report.html and more; docs/outputs.md
END

"$terse" report "$out/apal" "$out/bounded" --output "$out/report.html" --quiet
show() { printf '\nOpen in a browser:\n'; for page in "$@"; do echo "  $(cd "$(dirname "$page")" && pwd)/$(basename "$page")"; done; }

# Without OpenCV the command has no front end.
"$terse" generate stereo --help >/dev/null 2>&1 || { show "$out/report.html"; exit 0; }

printf '\nA street driven twice by a stereo camera, 400 frames\n\n'
rm -rf "$out/street"
"$terse" generate stereo --laps 2 --frames 400 --size 920x278 --seed 1 --output "$out/street"
"$terse" kitti "$out/street" --ground-truth "$out/street/poses.txt" --output "$out/street_map"
cat <<END

Images, calibration and ground truth, as KITTI has them: $out/street
Results: $out/street_map, trajectory.kitti.txt and trajectory.tum (all frames), compact.g2o (the map), covariances.csv, loops.csv,
stats.json, report.html and more
END
show "$out/report.html" "$out/street_map/report.html"
