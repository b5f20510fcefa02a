# terse_library(NAME SOURCES ... LINKS ... PRIVATE_LINKS ...): one shared library per folder.
#
# A missing arrow between folders is a link error (--no-undefined). Each library binds its own copies of the
# inline Eigen functions (-Bsymbolic), so that a program compiled with other -march flags cannot replace them.
function(terse_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;LINKS;PRIVATE_LINKS" ${ARGN})
  add_library(${name} SHARED ${ARG_SOURCES})
  string(REPLACE "terse_" "" export_name ${name})
  add_library(terse::${export_name} ALIAS ${name})
  set_target_properties(${name} PROPERTIES EXPORT_NAME ${export_name} VERSION ${PROJECT_VERSION}
                        SOVERSION ${PROJECT_VERSION_MAJOR})
  target_compile_features(${name} PUBLIC cxx_std_17)
  target_include_directories(${name} PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>
                             $<INSTALL_INTERFACE:include>)
  target_link_libraries(${name} PUBLIC ${ARG_LINKS} PRIVATE ${ARG_PRIVATE_LINKS})
  target_link_options(${name} PRIVATE -Wl,-Bsymbolic)
  if(NOT CMAKE_CXX_FLAGS MATCHES "sanitize")
    target_link_options(${name} PRIVATE -Wl,--no-undefined)
  endif()
  terse_warnings(${name})
endfunction()

function(terse_warnings name)
  target_compile_options(${name} PRIVATE -Wall -Wextra -Wconversion)
  if(TERSE_WERROR)
    target_compile_options(${name} PRIVATE -Werror)
  endif()
endfunction()
