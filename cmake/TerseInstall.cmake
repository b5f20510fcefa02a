# What `find_package(terse CONFIG)` reads: terse::lie, terse::core, terse::covariance, terse::compact, terse::terse
# for all of these, and terse::frontend. SuiteSparse is linked inside core and does not show.
include(CMakePackageConfigHelpers)
set(terse_cmakedir ${CMAKE_INSTALL_LIBDIR}/cmake/terse)

install(TARGETS terse EXPORT terseTargets)
install(EXPORT terseTargets NAMESPACE terse:: DESTINATION ${terse_cmakedir})
configure_package_config_file(cmake/terseConfig.cmake.in ${PROJECT_BINARY_DIR}/terseConfig.cmake
                              INSTALL_DESTINATION ${terse_cmakedir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/terseConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/terseConfig.cmake ${PROJECT_BINARY_DIR}/terseConfigVersion.cmake
        DESTINATION ${terse_cmakedir})
install(FILES LICENSE DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/terse)
