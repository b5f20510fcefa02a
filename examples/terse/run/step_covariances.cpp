#include "run/step_covariances.h"

#include "run/run_statistics.h"
#include "terse/core/number_text.h"
#include "terse/covariance/covariance_table.h"

namespace terse {

template <class Pose>
StepCovariances<Pose>::StepCovariances(const IncrementalSolver<Pose>& solver, const CovarianceConvention& convention,
                                       const std::string& path)
    : solver_(&solver), convention_(convention), marginals_(solver), file_(path) {
  file_.Stream() << "step,poses,path,columns,drift,seconds,position_variance_sum,rotation_variance_sum,id";
  WriteEntryNames(TangentNames<Pose>(convention.order), file_.Stream());
  file_.Stream() << '\n';
}

template <class Pose>
void StepCovariances<Pose>::Add(int step) {
  const double start = SecondsNow();
  const CovarianceReport report = marginals_.Update();
  const typename Pose::Jacobian newest = marginals_.Newest(convention_);
  const auto& all = marginals_.KeptMarginals();
  const double seconds = SecondsNow() - start;
  seconds_ += seconds;
  ++counts_[report.path];
  double position = 0, rotation = 0;
  for (const auto& covariance : all) {
    position += covariance.diagonal().template head<Pose::kDim>().sum();
    rotation += covariance.diagonal().template tail<Pose::kDof - Pose::kDim>().sum();
  }
  std::ostream& out = file_.Stream();
  out << step << ',' << all.size() << ',' << Name(report.path) << ',' << report.columns << ',' << Shortest(report.drift)
      << ',' << Shortest(seconds) << ',' << Shortest(position) << ',' << Shortest(rotation) << ','
      << solver_->Graph().Poses().back().id.value;
  WriteEntries(newest, out);
  out << '\n';
}

template <class Pose>
nlohmann::ordered_json StepCovariances<Pose>::PathCounts() const {
  nlohmann::ordered_json json;
  for (const auto path :
       {CovariancePath::kNone, CovariancePath::kPropagated, CovariancePath::kDowndated, CovariancePath::kRecursion}) {
    const auto count = counts_.find(path);
    json[Name(path)] = count == counts_.end() ? 0 : count->second;
  }
  return json;
}

template class StepCovariances<SE2>;
template class StepCovariances<SE3>;

}  // namespace terse
