include(GNUInstallDirs)

# terse_library(NAME SOURCES ... LINKS ... PRIVATE_LINKS ... [EXPORT SET]): one shared library per folder. An installed one
# finds its neighbours, and a program the libraries, wherever the tree is moved to.
#
# A missing arrow between folders is a link error (--no-undefined). Each library binds its own copies of the
# inline Eigen functions (-Bsymbolic), so that a program compiled with other -march flags cannot replace them.
# With sanitizers and fuzzers neither: their runtime is in the program, and it takes a second copy of a variable for an
# error. Functions are bound all the same, as those of tests are not optimised.
function(terse_library name)
  cmake_parse_arguments(ARG "" "EXPORT" "SOURCES;LINKS;PRIVATE_LINKS" ${ARGN})
  if(NOT ARG_EXPORT)
    set(ARG_EXPORT terseTargets)
  endif()
  add_library(${name} SHARED ${ARG_SOURCES})
  string(REPLACE "terse_" "" export_name ${name})
  add_library(terse::${export_name} ALIAS ${name})
  # Before 1.0 every minor version may change the binary interface.
  set_target_properties(${name} PROPERTIES EXPORT_NAME ${export_name} VERSION ${PROJECT_VERSION}
                        SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR} INSTALL_RPATH "$ORIGIN")
  target_compile_features(${name} PUBLIC cxx_std_17)
  # internal/: what the other libraries and the command need and users do not; it is not installed.
  target_include_directories(${name} PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>
                             $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/internal>
                             $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  target_link_libraries(${name} PUBLIC ${ARG_LINKS} PRIVATE ${ARG_PRIVATE_LINKS})
  if(NOT CMAKE_CXX_FLAGS MATCHES "-fsanitize" AND NOT TERSE_BUILD_FUZZERS)
    target_link_options(${name} PRIVATE -Wl,-Bsymbolic -Wl,--no-undefined)
  else()
    target_link_options(${name} PRIVATE -Wl,-Bsymbolic-functions)
  endif()
  terse_warnings(${name})
  terse_fuzzed(${name})
  terse_reuse_precompiled(${name} terse_library_headers)
  install(TARGETS ${name} EXPORT ${ARG_EXPORT} LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(DIRECTORY include/ DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
endfunction()

# terse_program(NAME SOURCES ... LINKS ... [FOLDER F]): a program that is installed, below the prefix to F, by default to
# bin. One that is not needs no function.
function(terse_program name)
  cmake_parse_arguments(ARG "" "FOLDER" "SOURCES;LINKS" ${ARGN})
  if(NOT ARG_FOLDER)
    set(ARG_FOLDER ${CMAKE_INSTALL_BINDIR})
  endif()
  GNUInstallDirs_get_absolute_install_dir(folder ARG_FOLDER BINDIR)
  file(RELATIVE_PATH libraries ${folder} ${CMAKE_INSTALL_FULL_LIBDIR})
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE ${ARG_LINKS})
  set_target_properties(${name} PROPERTIES INSTALL_RPATH "$ORIGIN/${libraries}")
  terse_warnings(${name})
  install(TARGETS ${name} RUNTIME DESTINATION ${ARG_FOLDER})
endfunction()

function(terse_warnings name)
  target_compile_options(${name} PRIVATE -Wall -Wextra -Wconversion)
  if(TERSE_WERROR)
    target_compile_options(${name} PRIVATE -Werror)
  endif()
endfunction()

# terse_builds_fast(NAME): what does not compute much itself compiles in half the time without the costly optimisations,
# where there are sanitizers without any.
function(terse_builds_fast name)
  target_compile_options(${name} PRIVATE $<$<CONFIG:Release>:-O1> $<$<CONFIG:Debug>:-O0>)
endfunction()

# terse_fuzzed(NAME): its code tells a fuzzer which branches an input took. Other programs can be linked to it all the same.
function(terse_fuzzed name)
  if(TERSE_BUILD_FUZZERS)
    target_compile_options(${name} PRIVATE -fsanitize=fuzzer-no-link)
  endif()
endfunction()
