# Scotch::Scotch: nested dissection (CeCILL-C). Include <scotch/scotch.h>.
find_path(Scotch_INCLUDE_DIR scotch/scotch.h)
find_library(Scotch_LIBRARY scotch)
find_library(Scotch_error_LIBRARY scotcherr)
mark_as_advanced(Scotch_INCLUDE_DIR Scotch_LIBRARY Scotch_error_LIBRARY)

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(Scotch
  REQUIRED_VARS Scotch_LIBRARY Scotch_error_LIBRARY Scotch_INCLUDE_DIR
  REASON_FAILURE_MESSAGE "On Debian it is in the package libscotch-dev.")

if(Scotch_FOUND AND NOT TARGET Scotch::Scotch)
  add_library(Scotch::Scotch INTERFACE IMPORTED)
  target_include_directories(Scotch::Scotch INTERFACE ${Scotch_INCLUDE_DIR})
  target_link_libraries(Scotch::Scotch INTERFACE ${Scotch_LIBRARY} ${Scotch_error_LIBRARY})
endif()
