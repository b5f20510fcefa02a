#define TERSE_KERNEL_NAMESPACE avx512
#define TERSE_VECTOR_DOUBLES 8
#define TERSE_TILE_VECTORS 3
#define TERSE_TILE_COLUMNS 8
#define TERSE_RANK_VECTORS 3
#include "cholesky/dense_kernels_impl.h"
