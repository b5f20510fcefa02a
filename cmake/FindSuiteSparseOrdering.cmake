# SuiteSparse::Ordering: the minimum-degree orderings AMD, CAMD, COLAMD and CCOLAMD (all BSD). Include <amd.h> and so on.
find_path(SuiteSparseOrdering_INCLUDE_DIR ccolamd.h PATH_SUFFIXES suitesparse)
set(libraries)
foreach(name amd camd ccolamd colamd suitesparseconfig)
  find_library(SuiteSparseOrdering_${name}_LIBRARY ${name})
  mark_as_advanced(SuiteSparseOrdering_${name}_LIBRARY)
  list(APPEND libraries SuiteSparseOrdering_${name}_LIBRARY)
endforeach()
mark_as_advanced(SuiteSparseOrdering_INCLUDE_DIR)

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(SuiteSparseOrdering
  REQUIRED_VARS ${libraries} SuiteSparseOrdering_INCLUDE_DIR
  REASON_FAILURE_MESSAGE "On Debian it is in the package libsuitesparse-dev.")

if(SuiteSparseOrdering_FOUND AND NOT TARGET SuiteSparse::Ordering)
  add_library(SuiteSparse::Ordering INTERFACE IMPORTED)
  target_include_directories(SuiteSparse::Ordering INTERFACE ${SuiteSparseOrdering_INCLUDE_DIR})
  foreach(library ${libraries})
    target_link_libraries(SuiteSparse::Ordering INTERFACE ${${library}})
  endforeach()
endif()
unset(libraries)
