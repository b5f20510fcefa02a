# Precompiled headers of other projects: half of the time of compiling this one goes into reading Eigen, GoogleTest and
# the standard library again for each source file. Terse's own headers are not among them, so that touching one compiles
# again only what includes it.
#
# Off by default where ccache is used: it caches a file with a precompiled header only with
# CCACHE_SLOPPINESS=pch_defines,time_macros, and what it has cached is faster still. Off with clang-tidy, which cannot read
# those of g++, and where terse is a part of another build.
if(PROJECT_IS_TOP_LEVEL AND NOT CMAKE_CXX_COMPILER_LAUNCHER MATCHES "ccache" AND NOT CMAKE_CXX_CLANG_TIDY)
  set(precompile ON)
else()
  set(precompile OFF)
endif()
option(TERSE_PCH "Precompile the headers of other projects" ${precompile})
unset(precompile)

set(terse_common_headers
  <algorithm> <array> <charconv> <chrono> <cmath> <cstdint> <cstdio> <filesystem> <fstream> <functional> <iostream> <limits>
  <map> <memory> <mutex> <numeric> <optional> <random> <set> <sstream> <stdexcept> <string> <string_view> <thread>
  <unordered_map> <utility> <variant> <vector> <Eigen/Cholesky> <Eigen/Core> <Eigen/Eigenvalues> <Eigen/Geometry> <Eigen/LU>
  <Eigen/SVD>)

# terse_precompiled(NAME HEADERS...): these headers and the common ones, read once for the sources of target NAME.
function(terse_precompiled name)
  if(TERSE_PCH)
    target_precompile_headers(${name} PRIVATE ${terse_common_headers} ${ARGN})
  endif()
endfunction()

# terse_precompiled_for(NAME LINKS ... HEADERS ...): the same for several targets that are compiled with the same flags.
# They say terse_reuse_precompiled(TARGET NAME).
function(terse_precompiled_for name)
  if(NOT TERSE_PCH)
    return()
  endif()
  cmake_parse_arguments(ARG "" "" "LINKS;HEADERS" ${ARGN})
  set(source ${CMAKE_CURRENT_BINARY_DIR}/${name}.cpp)
  if(NOT EXISTS ${source})
    file(WRITE ${source} "// The headers alone.\n")
  endif()
  add_library(${name} OBJECT ${source})
  target_compile_features(${name} PRIVATE cxx_std_17)
  target_link_libraries(${name} PRIVATE ${ARG_LINKS})
  terse_warnings(${name})
  terse_precompiled(${name} ${ARG_HEADERS})
endfunction()

function(terse_reuse_precompiled target name)
  if(TERSE_PCH)
    target_precompile_headers(${target} REUSE_FROM ${name})
  endif()
endfunction()
