#define TERSE_KERNEL_NAMESPACE avx2
#define TERSE_VECTOR_DOUBLES 4
#define TERSE_TILE_VECTORS 3
#define TERSE_TILE_COLUMNS 4
#define TERSE_RANK_VECTORS 2
#include "cholesky/dense_kernels_impl.h"
