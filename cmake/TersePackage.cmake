# `make package`: a Debian package with the command, the libraries, the headers and what finds them, in /usr. One package:
# who has the command can link to it.
find_program(TERSE_DPKG dpkg)
mark_as_advanced(TERSE_DPKG)
if(NOT PROJECT_IS_TOP_LEVEL OR NOT TERSE_DPKG)
  return()
endif()
set(TERSE_PACKAGE_CONTACT "The Terse authors <terse@packages.invalid>" CACHE STRING
    "Maintainer of the Debian package, NAME <ADDRESS>")

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME terse)
set(CPACK_PACKAGE_CONTACT "${TERSE_PACKAGE_CONTACT}")
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES TRUE)
set(CPACK_DEBIAN_COMPRESSION_TYPE gzip)  # until rebuild.cmake
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE
                                                WORLD_READ WORLD_EXECUTE)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "compact pose SLAM, command and C++ library")
set(CPACK_DEBIAN_PACKAGE_DESCRIPTION "\
Pose graphs in 2D and 3D that keep only the poses and links that carry
information: batch and incremental optimisation, covariances, compact maps
after Ila et al. (2017), robust loops, a stereo front end, evaluation.

This package has the command, the libraries and what is needed to build with
them.")
# The libraries themselves; then what the headers include.
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${CMAKE_LIBRARY_OUTPUT_DIRECTORY})
set(CPACK_DEBIAN_PACKAGE_CONTROL_EXTRA ${PROJECT_BINARY_DIR}/debian/shlibs ${PROJECT_SOURCE_DIR}/cmake/debian/triggers)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION TRUE)
set(CPACK_DEBIAN_PACKAGE_DEPENDS "libeigen3-dev (>= 3.4)")
set(CPACK_DEBIAN_PACKAGE_RECOMMENDS "librsvg2-bin, xdg-utils")  # terse plot --format png, terse report --open
if(TERSE_BUILD_FRONTEND)
  string(APPEND CPACK_DEBIAN_PACKAGE_RECOMMENDS ", libopencv-dev (>= 4.5)")  # terse::frontend; all else does without
endif()
if(TERSE_BUILD_PYTHON)
  string(APPEND CPACK_DEBIAN_PACKAGE_DEPENDS ", python3, python3-numpy")
endif()
set(CPACK_DEBIAN_PACKAGE_SUGGESTS "cmake, pkg-config, bash-completion")

# SOURCE_DATE_EPOCH is obeyed.
string(TIMESTAMP terse_package_date "%a, %d %b %Y %H:%M:%S +0000" UTC)
configure_file(cmake/debian/changelog.in ${PROJECT_BINARY_DIR}/debian/changelog @ONLY)
set(shlibs "")
foreach(name lie core covariance compact frontend)
  if(TARGET terse_${name})
    string(APPEND shlibs "libterse_${name} ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR} terse (>= ${PROJECT_VERSION})\n")
  endif()
endforeach()
file(WRITE ${PROJECT_BINARY_DIR}/debian/shlibs "${shlibs}")
configure_file(cmake/debian/overrides ${PROJECT_BINARY_DIR}/debian/overrides COPYONLY)
configure_file(cmake/debian/copyright ${PROJECT_BINARY_DIR}/debian/copyright COPYONLY)
configure_file(CHANGELOG.md ${PROJECT_BINARY_DIR}/debian/CHANGELOG.md COPYONLY)
set(CPACK_TERSE_DEBIAN ${PROJECT_BINARY_DIR}/debian)
set(CPACK_PRE_BUILD_SCRIPTS ${PROJECT_SOURCE_DIR}/cmake/debian/stage.cmake)
set(CPACK_POST_BUILD_SCRIPTS ${PROJECT_SOURCE_DIR}/cmake/debian/rebuild.cmake)
include(CPack)
