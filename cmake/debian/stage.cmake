# Run by cpack on the installed tree before it becomes a package: what Debian wants otherwise than `make install`.
set(root ${CPACK_TEMPORARY_DIRECTORY}/usr)
set(doc ${root}/share/doc/terse)

# One folder for all versions of Python, where it was built (TERSE_BUILD_PYTHON).
file(GLOB modules ${root}/lib/python3.*/dist-packages)
foreach(folder ${modules})
  file(MAKE_DIRECTORY ${root}/lib/python3)
  file(RENAME ${folder} ${root}/lib/python3/dist-packages)
  get_filename_component(versioned ${folder} DIRECTORY)
  file(REMOVE_RECURSE ${versioned})
endforeach()

# What needs MPI is not for everyone who wants the command; it is for those who build it.
file(GLOB distributed ${root}/bin/terse-mpi ${root}/lib/libterse_distributed.* ${root}/include/terse/distributed
     ${root}/lib/cmake/terse/terseDistributed*)
if(distributed)
  file(REMOVE_RECURSE ${distributed})
endif()

# The loader looks into /usr/lib anyway.
file(GLOB binaries ${root}/bin/* ${root}/libexec/terse/* ${root}/lib/*.so* ${root}/lib/python3/dist-packages/terse/*.so)
foreach(file ${binaries})
  if(NOT IS_SYMLINK ${file})
    file(RPATH_REMOVE FILE ${file})
  endif()
endforeach()

file(REMOVE ${doc}/LICENSE)  # it is in copyright
file(COPY ${CPACK_TERSE_DEBIAN}/copyright ${CPACK_TERSE_DEBIAN}/changelog ${CPACK_TERSE_DEBIAN}/CHANGELOG.md
     DESTINATION ${doc} FILE_PERMISSIONS OWNER_READ OWNER_WRITE GROUP_READ WORLD_READ)
configure_file(${CPACK_TERSE_DEBIAN}/overrides ${root}/share/lintian/overrides/terse COPYONLY
               FILE_PERMISSIONS OWNER_READ OWNER_WRITE GROUP_READ WORLD_READ)
file(GLOB manuals ${root}/share/man/man1/*.1)
execute_process(COMMAND gzip -9n ${doc}/changelog ${doc}/CHANGELOG.md ${manuals} COMMAND_ERROR_IS_FATAL ANY)
