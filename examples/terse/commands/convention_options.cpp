#include "commands/convention_options.h"

#include "commands/commands.h"
#include "terse/covariance/covariance_table.h"

namespace terse {
namespace {

template <class Value>
std::vector<std::pair<std::string, Value>> Named(const std::vector<Value>& values) {
  std::vector<std::pair<std::string, Value>> out;
  for (const Value value : values) out.emplace_back(Name(value), value);
  return out;
}

}  // namespace

std::vector<CLI::Option*> AddConventionOptions(CLI::App& subcommand, CovarianceConvention& convention) {
  using Frame = CovarianceFrame;
  using Order = TangentOrder;
  return {
      AddChoice(subcommand, "--frame", convention.frame, Named<Frame>({Frame::kBody, Frame::kWorld, Frame::kWorldAxes}),
                "Of covariances: of d in T Exp(d), of e in Exp(e) T (for a relative pose, the frame of its first "
                "pose), or of position and rotation along the world's axes, as ROS has them"),
      AddChoice(subcommand, "--order", convention.order,
                Named<Order>({Order::kTranslationFirst, Order::kRotationFirst}), "Of rows and columns of covariances")};
}

}  // namespace terse
