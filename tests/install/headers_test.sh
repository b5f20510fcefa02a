#!/usr/bin/env bash
# Every installed header compiles on its own, and none needs a header that is not installed.
#
# Usage: headers_test.sh PREFIX SOURCE WORK PRECOMPILED COMPILER INCLUDE_FOLDER... Without precompiled headers, a header that
# a source file of the library includes first has been compiled on its own by the build; the others are here, and all of
# them together.
set -euo pipefail
include=$1/include source=$2 work=$3/headers precompiled=$4 compiler=$5
shift 5
flags=(-std=c++17 -fsyntax-only -Wall -Wextra -Wconversion -Werror -I "$include")
for folder in "$@"; do flags+=(-isystem "$folder"); done

rm -rf "$work"
mkdir -p "$work"
shown=
if [[ $precompiled == 0 ]]; then
  shown=$(for file in "$source"/{lie,core,covariance,compact,frontend}/*.cpp; do grep -m1 '^#include "' "$file" || true; done)
fi
count=0
for header in $(cd "$include" && find terse -name '*.h' | sort); do
  [[ $header != */internal/* ]] || { echo "$header is installed" >&2; exit 1; }
  echo "#include <$header>" >>"$work/all.cpp"
  [[ $shown == *"\"$header\""* ]] || echo "#include <$header>" >"$work/${header//\//_}.cpp"
  count=$((count + 1))
done
[[ $count -gt 20 ]] || { echo "only $count headers below $include" >&2; exit 1; }
find "$work" -name '*.cpp' -print0 | xargs -0 -n 1 -P 2 "$compiler" "${flags[@]}"
echo "$count headers, $(($(find "$work" -name '*.cpp' | wc -l) - 1)) of them compiled here one by one"
