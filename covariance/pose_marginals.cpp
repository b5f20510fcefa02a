#include "terse/covariance/pose_marginals.h"

#include <stdexcept>

#include "terse/core/decompositions.h"
#include "terse/covariance/covariance_blocks.h"

namespace terse {

using std::size_t;

template <class Pose>
std::vector<int> PoseMarginals<Pose>::IndicesOf(const std::vector<PoseId>& ids) const {
  std::vector<int> indices;
  indices.reserve(ids.size());
  for (const PoseId id : ids) indices.push_back(IndexOf(id));
  return indices;
}

template <class Pose>
typename Pose::Jacobian PoseMarginals<Pose>::Marginal(PoseId id, const CovarianceConvention& convention) const {
  return MarginalsOf({id}, convention).front();
}

template <class Pose>
std::vector<typename Pose::Jacobian> PoseMarginals<Pose>::MarginalsOf(const std::vector<PoseId>& ids,
                                                                      const CovarianceConvention& convention) const {
  const std::vector<int> indices = IndicesOf(ids);
  std::vector<Jacobian> out = DiagonalBlocks(indices);
  if (convention.IsNative()) return out;
  for (size_t k = 0; k < out.size(); ++k) out[k] = ConvertCovariance<Pose>(out[k], ValueAt(indices[k]), convention);
  return out;
}

template <class Pose>
std::vector<typename Pose::Jacobian> PoseMarginals<Pose>::AllMarginals(const CovarianceConvention& convention) const {
  std::vector<Jacobian> out = AllDiagonalBlocks();
  if (convention.IsNative()) return out;
  for (size_t i = 0; i < out.size(); ++i) {
    out[i] = ConvertCovariance<Pose>(out[i], ValueAt(static_cast<int>(i)), convention);
  }
  return out;
}

template <class Pose>
typename Pose::Jacobian PoseMarginals<Pose>::Cross(PoseId a, PoseId b, const CovarianceConvention& convention) const {
  return Column(b, {a}, convention).front();
}

template <class Pose>
std::vector<typename Pose::Jacobian> PoseMarginals<Pose>::Column(PoseId of, const std::vector<PoseId>& ids,
                                                                 const CovarianceConvention& convention) const {
  const int column = IndexOf(of);
  const std::vector<int> indices = IndicesOf(ids);
  std::vector<Jacobian> out = ColumnBlocks(column, indices);
  if (convention.IsNative()) return out;
  const Pose T_of = ValueAt(column);
  for (size_t k = 0; k < out.size(); ++k) {
    out[k] = ConvertCrossCovariance<Pose>(out[k], ValueAt(indices[k]), T_of, convention);
  }
  return out;
}

template <class Pose>
std::vector<typename Pose::Jacobian> PoseMarginals<Pose>::ColumnBlocks(int of, const std::vector<int>& indices) const {
  const MatrixX blocks = CovarianceBlocks(CholeskyOfAll(), indices, {of});
  std::vector<Jacobian> out(indices.size());
  for (size_t k = 0; k < out.size(); ++k) out[k] = blocks.middleRows<B>(static_cast<Eigen::Index>(k) * B);
  return out;
}

template <class Pose>
MatrixX PoseMarginals<Pose>::Joint(const std::vector<PoseId>& ids, const CovarianceConvention& convention) const {
  const std::vector<int> indices = IndicesOf(ids);
  MatrixX joint = JointCovariance(CholeskyOfAll(), indices);
  if (convention.IsNative()) return joint;
  for (size_t r = 0; r < ids.size(); ++r) {
    for (size_t c = 0; c < ids.size(); ++c) {
      auto block = joint.block<B, B>(static_cast<Eigen::Index>(r) * B, static_cast<Eigen::Index>(c) * B);
      block = ConvertCrossCovariance<Pose>(block, ValueAt(indices[r]), ValueAt(indices[c]), convention);
    }
  }
  return (joint + joint.transpose()) / 2;
}

template <class Pose>
typename Pose::Jacobian PoseMarginals<Pose>::Relative(PoseId a, PoseId b,
                                                      const CovarianceConvention& convention) const {
  const int i = IndexOf(a), j = IndexOf(b);
  if (i == j) throw std::invalid_argument("a relative pose needs two distinct poses");
  // d_ab = d_b - Ad(T_a_b^-1) d_a, in which what moves both poses together cancels where H is linearised only.
  const Pose T_a_b_point = PointAt(i).Inverse() * PointAt(j), T_a_b = ValueAt(i).Inverse() * ValueAt(j);
  const Jacobian A = T_a_b_point.Inverse().Adjoint();
  const Jacobian at_point = CombinationCovariance<B>(CholeskyOfAll(), {{i, -A}, {j, Jacobian::Identity()}});
  const Jacobian covariance = MoveCovariance<Pose>(at_point, T_a_b_point, T_a_b);
  return ConvertCovariance<Pose>(covariance, T_a_b, convention);
}

template <class Pose>
typename Pose::Jacobian PoseMarginals<Pose>::Combination(const std::vector<Term>& terms) const {
  std::vector<CovarianceTerm<B>> sum;
  sum.reserve(terms.size());
  for (const Term& term : terms) sum.push_back({IndexOf(term.id), term.A});
  return CombinationCovariance<B>(CholeskyOfAll(), sum);
}

template <class Pose>
typename Pose::Jacobian MoveCovariance(const typename Pose::Jacobian& covariance, const Pose& T_from,
                                       const Pose& T_to) {
  const typename Pose::Jacobian J = InverseOf<Pose::kDof>(Pose::LocalJacobian(T_from.Local(T_to)));
  const typename Pose::Jacobian out = J * covariance * J.transpose();
  return (out + out.transpose()) / 2;
}

template <class Pose>
typename Pose::Jacobian RelativeCovariance(const Pose& T_a_b, const typename Pose::Jacobian& Sigma_aa,
                                           const typename Pose::Jacobian& Sigma_ab,
                                           const typename Pose::Jacobian& Sigma_bb) {
  // T_a_b <- T_a_b Exp(d_b - Ad(T_a_b^-1) d_a).
  using Jacobian = typename Pose::Jacobian;
  const Jacobian A = T_a_b.Inverse().Adjoint();
  const Jacobian cross = A * Sigma_ab;
  const Jacobian out = A * Sigma_aa * A.transpose() + Sigma_bb - cross - cross.transpose();
  return (out + out.transpose()) / 2;
}

template class PoseMarginals<SE2>;
template class PoseMarginals<SE3>;
template SE2::Jacobian MoveCovariance<SE2>(const SE2::Jacobian&, const SE2&, const SE2&);
template SE3::Jacobian MoveCovariance<SE3>(const SE3::Jacobian&, const SE3&, const SE3&);
template SE2::Jacobian RelativeCovariance<SE2>(const SE2&, const SE2::Jacobian&, const SE2::Jacobian&,
                                               const SE2::Jacobian&);
template SE3::Jacobian RelativeCovariance<SE3>(const SE3&, const SE3::Jacobian&, const SE3::Jacobian&,
                                               const SE3::Jacobian&);

}  // namespace terse
