# SuiteSparse::Cholmod: the reference factorisation of tests and benchmarks. Parts of it are GPL: the library never
# links it. Include <cholmod.h>.
find_path(Cholmod_INCLUDE_DIR cholmod.h PATH_SUFFIXES suitesparse)
find_library(Cholmod_LIBRARY cholmod)
mark_as_advanced(Cholmod_INCLUDE_DIR Cholmod_LIBRARY)

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(Cholmod REQUIRED_VARS Cholmod_LIBRARY Cholmod_INCLUDE_DIR
  REASON_FAILURE_MESSAGE "On Debian it is in the package libsuitesparse-dev.")

if(Cholmod_FOUND AND NOT TARGET SuiteSparse::Cholmod)
  add_library(SuiteSparse::Cholmod INTERFACE IMPORTED)
  target_include_directories(SuiteSparse::Cholmod INTERFACE ${Cholmod_INCLUDE_DIR})
  target_link_libraries(SuiteSparse::Cholmod INTERFACE ${Cholmod_LIBRARY})
endif()
