#!/usr/bin/env bash
# Every installed header compiles on its own, and none needs a header that is not installed.
#
# Usage: headers_test.sh PREFIX SOURCE WORK PRECOMPILED COMPILER INCLUDE_FOLDER... Without precompiled headers, a header that
# a source file of the library includes first has been compiled on its own by the build; the others are here, and all of
# them together.
set -euo pipefail
include=$1/include source=$2 work=$3/headers precompiled=$4 compiler=$5
shift 5
flags=(-std=c++17 -Wall -Wextra -Wconversion -Werror -Winvalid-pch -I "$include")
for folder in "$@"; do flags+=(-isystem "$folder"); done

rm -rf "$work"
mkdir -p "$work/plain"
shown=
if [[ $precompiled == 0 ]]; then
  shown=$(for file in "$source"/{lie,core,covariance,compact,frontend}/*.cpp; do grep -m1 '^#include "' "$file" || true; done)
fi
cd "$include"
mapfile -t headers < <(find terse -name '*.h' | sort)
[[ ${#headers[@]} -gt 20 ]] || { echo "only ${#headers[@]} headers below $include" >&2; exit 1; }

# reaching INCLUDE: the headers that include it, themselves or by others of them.
reaching() {
  local -A found=()
  local count=-1 header
  for header in $(grep -lF "#include $1" "${headers[@]}"); do found[$header]=1; done
  while [[ $count != "${#found[@]}" ]]; do
    count=${#found[@]}
    for header in $(printf '#include "%s"\n' "${!found[@]}" | grep -lFf - "${headers[@]}"); do found[$header]=1; done
  done
  printf '%s\n' "${!found[@]}"
}
# What most of them include is precompiled for those that include it, as if they did so first; of two of these the second
# includes the first.
declare -A folder_of
precompiled_for=()
for include_of in '<Eigen/Core>' '"terse/lie/se3.h"' '"terse/core/pose_graph.h"'; do
  folder=$work/$(tr -cd 'a-zA-Z_' <<<"$include_of")
  mkdir "$folder"
  echo "#include $include_of" >"$folder/first.h"
  precompiled_for+=("$folder")
  for header in $(reaching "$include_of"); do folder_of[$header]=$folder; done
done

for header in "${headers[@]}"; do
  [[ $header != */internal/* ]] || { echo "$header is installed" >&2; exit 1; }
  echo "#include <$header>" >>"$work/plain/all.cpp"
  [[ $shown != *"\"$header\""* ]] || continue
  echo "#include <$header>" >"${folder_of[$header]-$work/plain}/${header//\//_}.cpp"
done
compile() { find "$1" -name '*.cpp' -print0 | xargs -0 -r -n 1 -P 2 "$compiler" "${flags[@]}" -fsyntax-only "${@:2}"; }
printf '%s\n' "${precompiled_for[@]}" |
  xargs -P 2 -I{} "$compiler" "${flags[@]}" -x c++-header {}/first.h -o {}/first.h.gch
for folder in "${precompiled_for[@]}"; do compile "$folder" -include "$folder/first.h"; done
compile "$work/plain"
echo "${#headers[@]} headers, $(($(find "$work" -name '*.cpp' | wc -l) - 1)) of them compiled here one by one"
