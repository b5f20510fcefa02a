#!/usr/bin/env bash
# run.sh SOURCE_FOLDER BUILD_FOLDER [REPORT.html ...]: tests the report page, and reports that `terse report` wrote, in headless
# Chromium. Packages are installed into copies in the build folder, when their lock files changed.
set -euo pipefail
source=$1 build=$2
shift 2

fail() { echo "FAIL  $1" >&2; exit 1; }
for tool in node npm; do
  command -v $tool >/dev/null || fail "$tool is not on PATH. Install the packages nodejs and npm."
done

# install FROM TO: a copy of a folder of the sources, with the packages of its lock file.
install() {
  mkdir -p "$2"
  (cd "$1" && tar cf - --exclude=node_modules .) | tar xf - -C "$2"
  cmp -s "$2/package-lock.json" "$2/node_modules/.installed" && return
  (cd "$2" && npm ci --loglevel=error) || fail "npm ci in $2 failed; it needs the npm registry"
  cp "$2/package-lock.json" "$2/node_modules/.installed"
}

install "$source/tests/report" "$build/tests"
if [[ $# -gt 0 ]]; then
  exec node "$build/tests/run.mjs" "$@"
fi
install "$source/examples/report" "$build/page"
exec node "$build/tests/run.mjs" --page "$source/examples/report/report.html" --sources "$build/page"
