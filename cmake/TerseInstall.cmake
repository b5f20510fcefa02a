# What `find_package(terse CONFIG)` reads: terse::lie, terse::core, terse::covariance, terse::compact, terse::terse
# for all of these, terse::frontend where OpenCV is found, and terse::distributed by COMPONENTS if it was built. For
# pkg-config: terse and terse-frontend. SuiteSparse is linked inside core and does not show.
include(CMakePackageConfigHelpers)
set(terse_cmakedir ${CMAKE_INSTALL_LIBDIR}/cmake/terse)

install(TARGETS terse EXPORT terseTargets)
install(EXPORT terseTargets NAMESPACE terse:: DESTINATION ${terse_cmakedir})
if(TARGET terse_frontend)
  install(EXPORT terseFrontendTargets NAMESPACE terse:: DESTINATION ${terse_cmakedir})
endif()
if(TARGET terse_distributed)
  install(EXPORT terseDistributedTargets NAMESPACE terse:: DESTINATION ${terse_cmakedir})
endif()
configure_package_config_file(cmake/terseConfig.cmake.in ${PROJECT_BINARY_DIR}/terseConfig.cmake
                              INSTALL_DESTINATION ${terse_cmakedir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/terseConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/terseConfig.cmake ${PROJECT_BINARY_DIR}/terseConfigVersion.cmake
        DESTINATION ${terse_cmakedir})

# Relative to where they lie, so that the tree can be moved.
file(RELATIVE_PATH terse_prefix_from_pc /prefix/${CMAKE_INSTALL_LIBDIR}/pkgconfig /prefix)
configure_file(cmake/terse.pc.in ${PROJECT_BINARY_DIR}/terse.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/terse.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
if(TARGET terse_frontend)
  configure_file(cmake/terse-frontend.pc.in ${PROJECT_BINARY_DIR}/terse-frontend.pc @ONLY)
  install(FILES ${PROJECT_BINARY_DIR}/terse-frontend.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
endif()

install(FILES LICENSE DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/terse)
