#!/usr/bin/env bash
# run.sh PROGRAM SECONDS FOLDER [OPTION...]: fuzzes with the seeds of corpus/. What is found lies in FOLDER/NAME: crash-*
# are inputs that break it, corpus/ those that took new branches, which the next run starts from (with -seed=... none).
set -euo pipefail
program=$1 seconds=$2 name=$(basename "$1") folder=$3
name=${name#fuzz_}
here=$(cd "$(dirname "$0")" && pwd)
shift 3

if [[ " $* " == *" -seed="* ]]; then rm -rf "${folder:?}/$name"; fi
mkdir -p "$folder/$name/corpus"
case $name in
  run_folder) length=20000 ;;
  graph_json) length=8000 ;;
  state | png) length=4000 ;;
  *) length=1000 ;;
esac
options=(-max_total_time="$seconds" -max_len=$length -timeout=10 -rss_limit_mb=1024 -print_final_stats=1 -entropic=0
  -artifact_prefix="$folder/$name/")
if [[ -f $here/$name.dict ]]; then options+=(-dict="$here/$name.dict"); fi
export ASAN_OPTIONS=quarantine_size_mb=16:malloc_context_size=4:${ASAN_OPTIONS:-} UBSAN_OPTIONS=print_stacktrace=1
set +e
"$program" "${options[@]}" "$@" "$folder/$name/corpus" "$here/corpus/$name" 2>&1 | tee "$folder/$name/log" |
  grep -E '^(stat::number|stat::average|stat::peak|==|SUMMARY|fuzzer:)|artifact|ERROR|runtime error|    #[0-9]+ 0x'
exit "${PIPESTATUS[0]}"
