# Several sources compiled as one: what they all instantiate of Eigen, CLI11 and JSON is compiled once. That takes half of
# the time, and a fifth where the command is concerned; touching one source compiles its batch again, so who works on the
# sources may want -D TERSE_UNITY=OFF. Names in anonymous namespaces have to differ within a batch, and from those of
# headers: they would take their place without an error, as a Describe() once did in the Python package.
#
# Where each source is to be seen for itself (ccache, clang-tidy, another build's part) it is off, as precompiled headers are.
option(TERSE_UNITY "Compile several sources as one" ${TERSE_PCH})

# terse_unity(NAME BATCH): so many sources of target NAME at a time, in the order in which they are listed.
function(terse_unity name batch)
  if(TERSE_UNITY)
    set_target_properties(${name} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE ${batch})
    # An anonymous namespace in what is included is an error only where it is included twice.
    target_compile_options(${name} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-Wno-subobject-linkage>)
  endif()
endfunction()

# terse_unity_by_folder(NAME): the same, those of a folder together.
function(terse_unity_by_folder name)
  terse_unity(${name} 0)
  set_target_properties(${name} PROPERTIES UNITY_BUILD_MODE GROUP)
  get_target_property(sources ${name} SOURCES)
  foreach(source ${sources})
    get_filename_component(folder ${source} DIRECTORY)
    string(MAKE_C_IDENTIFIER "${folder}" folder)
    set_source_files_properties(${source} PROPERTIES UNITY_GROUP "${folder}")
  endforeach()
endfunction()
