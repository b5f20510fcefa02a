#pragma once
// The information a link would add, in nats (Ila et al. 2017 Eq. 22).

#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse {

// Mutual information of a relative-pose measurement with covariance Sigma_y of a displacement known
// with covariance Sigma_d, both at the same relative pose in its body frame: 1/2 ln |I + Sigma_y^-1 Sigma_d|.
// The same scale before registration (expected Sigma_y) and after it (measured).
template <int B>
double InformationGain(const Matrix<B, B>& Sigma_d, const Matrix<B, B>& Sigma_y);

}  // namespace terse
