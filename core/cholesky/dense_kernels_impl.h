// The dense kernels for one instruction set. Included by dense_kernels_*.cpp, each compiled for its own, after these
// are defined:
//   TERSE_KERNEL_NAMESPACE, TERSE_VECTOR_DOUBLES (per register), TERSE_TILE_VECTORS x TERSE_TILE_COLUMNS (register
//   tile), TERSE_RANK_VECTORS (of rows at a time in a rank update).
// Everything else has internal linkage and nothing from the standard library or Eigen is used: an inline function
// compiled here for a newer processor must not become the copy that the whole program runs.

#include "cholesky/assembly_kernels.h"
#include "cholesky/covariance_kernels.h"
#include "cholesky/factor_kernels.h"
