#!/usr/bin/env bash
# Makes the Debian package, installs it into a root of its own, and uses what it brought as a user would.
#
# Usage: package_test.sh BUILD WORK SOURCE VERSION COMPILER. Needs no root rights: dpkg --root with a copy of the
# system's package list, so that the dependencies are checked too.
set -euo pipefail
build=$1 work=$2/package source=$3 version=$4 compiler=$5
unset DESTDIR LD_LIBRARY_PATH CXXFLAGS PKG_CONFIG_PATH

fail() { echo "FAILED: $*" >&2; exit 1; }
contains() { [[ $2 == *"$1"* ]] || fail "no '$1' in: $2"; }
has() { command -v "$1" >/dev/null || { echo "not checked, there is no $1: $2"; return 1; }; }

for tool in dpkg-shlibdeps file gzip; do
  command -v "$tool" >/dev/null || { echo "SKIPPED: no $tool, on Debian in dpkg-dev, file, gzip"; exit 0; }
done
rm -rf "$work"
mkdir -p "$work"
(cd "$work" && cpack --config "$build/CPackConfig.cmake" -G DEB -B "$work" >cpack.log 2>&1) || fail "$(cat "$work/cpack.log")"
deb=$work/terse_${version}_$(dpkg --print-architecture).deb
[[ -f $deb ]] || fail "no $deb"

# --- Installed.
root=$work/root
mkdir -p "$root/var/lib/dpkg/info" "$root/var/lib/dpkg/updates"
cp /var/lib/dpkg/status "$root/var/lib/dpkg/"
sed -i '/^Package: terse$/,/^$/d' "$root/var/lib/dpkg/status"
PATH=$PATH:/usr/sbin:/sbin dpkg --root="$root" --force-not-root --log="$work/dpkg.log" -i "$deb" >"$work/install.log" 2>&1 ||
  fail "$(grep -v 'files list file' "$work/install.log")"
contains "install ok installed" "$(dpkg --root="$root" -s terse)"
usr=$root/usr

# --- What is in it.
has_frontend=no
[[ -e $usr/lib/libterse_frontend.so ]] && has_frontend=yes
major_minor=${version%.*}
libraries="lie core covariance compact"
[[ $has_frontend == yes ]] && libraries+=" frontend"
for name in $libraries; do
  [[ $(readlink "$usr/lib/libterse_$name.so") == "libterse_$name.so.$major_minor" ]] || fail "libterse_$name.so"
  [[ $(readlink "$usr/lib/libterse_$name.so.$major_minor") == "libterse_$name.so.$version" ]] || fail "link of $name"
  dynamic=$(LC_ALL=C readelf -d "$usr/lib/libterse_$name.so.$version")
  contains "soname: [libterse_$name.so.$major_minor]" "$dynamic"
  [[ $dynamic != *RUNPATH* && $dynamic != *RPATH* ]] || fail "libterse_$name has a run path"
done
programs=$usr/bin/terse
[[ $has_frontend == no ]] || programs+=" $usr/libexec/terse/terse-stereo"
for program in $programs; do
  dynamic=$(LC_ALL=C readelf -d "$program")
  [[ $dynamic != *RUNPATH* && $dynamic != *RPATH* ]] || fail "$program has a run path"
done
for file in include/terse/core/pose_graph.h include/terse/compact/compact_pose_slam.h lib/cmake/terse/terseConfig.cmake \
  lib/pkgconfig/terse.pc share/doc/terse/copyright share/doc/terse/changelog.gz share/man/man1/terse.1.gz \
  share/bash-completion/completions/terse; do
  [[ -s $usr/$file ]] || fail "no $file"
done
depends=$(dpkg-deb -f "$deb" Depends)
for package in libeigen3-dev libtbb libccolamd libc6; do contains "$package" "$depends"; done
! grep -rlF -e "$build" -e "$source" "$usr" || fail "a file names this machine's folders"
owners=$(dpkg-deb -c "$deb" | awk '{print $2}' | sort -u)
[[ $owners == root/root ]] || fail "owners: $owners"
if has lintian "errors that lintian finds"; then
  errors=$(lintian --fail-on none "$deb" 2>/dev/null | grep '^E:' || true)
  [[ -z $errors ]] || fail "$errors"
fi

# --- The command, its manual and its completion.
export LD_LIBRARY_PATH=$usr/lib PATH=$usr/bin:$PATH
cd "$work"
contains "terse $version" "$(terse --version)"
terse generate ellipse --output ellipse.g2o
contains '"poses": 170' "$(terse info ellipse.g2o --json)"
[[ $has_frontend == no ]] || contains "--ground-truth" "$(terse kitti --help)"

subcommands=$(terse --help | sed -n '/^Subcommands:/,/^$/s/^  \([a-z0-9-]\+\) .*/\1/p')
contains compact "$subcommands"
if has man "the manual page"; then
  page=$(LC_ALL=C.UTF-8 MANWIDTH=100 man --warnings -l "$usr/share/man/man1/terse.1.gz" 2>manual.err | col -b)
  [[ ! -s manual.err ]] || fail "$(cat manual.err)"
  for subcommand in $subcommands; do contains "terse $subcommand [OPTIONS]" "$page"; done
  contains "--strategy apal|apfl|fpfl|rfpfl" "$page"
fi
if has mandoc "the manual page, by mandoc"; then
  mandoc -T lint -W error "$usr/share/man/man1/terse.1.gz" || fail "mandoc"
fi

# complete WORD...: what Tab offers when the last word is the one at the cursor. Bash takes = for a word of its own.
complete() {
  bash --norc -c 'source "$0"
    builtin complete -p terse >/dev/null || exit 1
    COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMPREPLY=()
    _terse
    echo "${COMPREPLY[*]}"' "$usr/share/bash-completion/completions/terse" "$@"
}
# expect WORDS ARGUMENTS...: that is what it offers.
expect() {
  local offered
  offered=$(complete "${@:2}")
  [[ $offered == "$1" ]] || fail "${*:2}: completed to '$offered' instead of '$1'"
}
expect "compact" terse com
expect "apal apfl fpfl rfpfl bounded" terse compact --strategy ""
expect "fpfl" terse compact --strategy = fp
expect "apal apfl fpfl rfpfl bounded" terse compact --strategy =
expect "ellipse ellipse-n" terse generate el
expect "ellipse.g2o" terse solve ellipse.g
expect "ellipse.g2o" terse compact --auto-thresholds ellipse.g
expect "--threads" terse solve --thr
expect "" terse solve --threads ""
for subcommand in "" $subcommands; do  # every option that --help lists
  options=$(terse $subcommand --help | sed -n '/^Options:/,/^$/s/^  \(-[a-z],\)\?\(--[a-z0-9-]\+\).*/\2/p')
  [[ -n $options ]] || fail "no options of $subcommand"
  offered=" $(complete terse $subcommand --) "
  for option in $options; do contains " $option " "$offered"; done
done

# --- A program linked to it: by CMake, and by pkg-config.
consumer=$source/tests/install/consumer
cmake -S "$consumer" -B cmake_consumer -D CMAKE_CXX_COMPILER="$compiler" \
  -D CMAKE_PREFIX_PATH="$usr" >cmake.log 2>&1 || fail "$(cat cmake.log)"
grep -q "^terse_DIR:PATH=$usr/lib/cmake/terse" cmake_consumer/CMakeCache.txt || fail "another terse was found"
cmake --build cmake_consumer --target consumer >cmake.log 2>&1 || fail "$(cat cmake.log)"
cmake_consumer/consumer cmake.g2o >cmake.txt
contains "solve: converged" "$(cat cmake.txt)"
if has pkg-config "the pkg-config files"; then
  export PKG_CONFIG_PATH=$usr/lib/pkgconfig
  [[ $(pkg-config --modversion terse) == "$version" ]] || fail "version of terse.pc"
  contains eigen3 "$(pkg-config --cflags terse)"
  # shellcheck disable=SC2046
  "$compiler" -std=c++17 "$consumer/main.cpp" -o pkg_consumer $(pkg-config --cflags --libs terse)
  ./pkg_consumer pkg.g2o >pkg.txt
  cmp cmake.txt pkg.txt
  if [[ $has_frontend == yes ]]; then
    echo '#include <terse/frontend/stereo_slam.h>
      int main() { return terse::StereoCompactOptions().consensus > 0 && cv::Mat(2, 2, CV_8U).rows == 2 ? 0 : 1; }' >frontend.cpp
    # shellcheck disable=SC2046
    "$compiler" -std=c++17 frontend.cpp -o frontend_consumer $(pkg-config --cflags --libs terse-frontend)
    ./frontend_consumer
  fi
fi

# --- Gone again, without a trace.
PATH=$PATH:/usr/sbin:/sbin dpkg --root="$root" --force-not-root --log="$work/dpkg.log" -r terse >"$work/install.log" 2>&1 ||
  fail "$(grep -v 'files list file' "$work/install.log")"
left=$(find "$usr" -not -type d 2>/dev/null || true)
[[ -z $left ]] || fail "left behind: $left"
ls -l "$deb"
