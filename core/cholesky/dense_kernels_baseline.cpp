#define TERSE_KERNEL_NAMESPACE baseline
#define TERSE_VECTOR_DOUBLES 2
#define TERSE_TILE_VECTORS 2
#define TERSE_TILE_COLUMNS 4
#define TERSE_RANK_VECTORS 1
#include "cholesky/dense_kernels_impl.h"
