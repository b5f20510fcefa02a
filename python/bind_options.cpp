// Options of the incremental solver and of compact pose SLAM.

#include <pybind11/stl.h>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "terse/compact/state_members.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

using Type = py::class_<IncrementalOptions, std::shared_ptr<IncrementalOptions>>;

// An enumeration as a property with its word.
template <class Class, class E>
void DefWord(Class& type, const char* name, E IncrementalOptions::*member, const char* doc) {
  type.def_property(
      name, [member](const IncrementalOptions& o) { return WordOf(o.*member); },
      [member](IncrementalOptions& o, const std::string& word) { o.*member = FromWord<E>(word); }, doc);
}

void BindIncrementalOptions(py::module_& module) {
  Type type(module, "IncrementalOptions",
            "How much an incremental step re-optimises. The defaults suit all graphs that were tried.");
  type.def(py::init([](const std::string& policy, const py::kwargs& keywords) {
             const auto options = std::make_shared<IncrementalOptions>(PolicyOptions(FromWord<Policy>(policy)));
             SetAttributes(py::cast(options), keywords);
             return options;
           }),
           py::arg("policy") = "default",
           "policy: 'default', or one of Arablouei's variants: 'gn1', 'gni', 'gni-lcg', 'gni-igg', 'gni-spo', "
           "'gni-spo-lcg', 'gni-spo-igg'. Any attribute can be given by keyword.");
  DefWord(type, "carry", &IncrementalOptions::carry,
          "'offset': estimate = linearisation point + d; 'point': the estimate is the linearisation point.");
  DefWord(type, "gate", &IncrementalOptions::gate,
          "What has to exceed gate_threshold for a step to be optimised: 'newton_decrement', 'mutual_information', "
          "'log_determinant', 'loop_closure', 'always' or 'never'.");
  DefWord(type, "decrease_scale", &IncrementalOptions::decrease_scale,
          "Unit of the threshold of newton_decrement: 'absolute', 'chi2' or 'dof'.");
  type.def_readwrite("gate_threshold", &IncrementalOptions::gate_threshold, "In the gate's unit.")
      .def_readwrite("relinearize_tolerance", &IncrementalOptions::relinearize_tolerance,
                     "Linearisation errors that are tolerated, as a share of chi2.")
      .def_readwrite("relinearize_metres", &IncrementalOptions::relinearize_metres,
                     "Only poses that moved farther, or turned by more than relinearize_radians, are looked at.")
      .def_readwrite("relinearize_radians", &IncrementalOptions::relinearize_radians, "See relinearize_metres.")
      .def_readwrite("relinearize_interval", &IncrementalOptions::relinearize_interval,
                     "Relinearisation is considered at every n-th step.")
      .def_readwrite("propagation_tolerance", &IncrementalOptions::propagation_tolerance,
                     "Back-substitution stops where it would change chi2 by less than this share. 0 is exact.")
      .def_readwrite("max_iterations", &IncrementalOptions::max_iterations, "Gauss-Newton iterations in a step.")
      .def_readwrite("step_metres", &IncrementalOptions::step_metres, "'point': steps below move nothing.")
      .def_readwrite("step_radians", &IncrementalOptions::step_radians, "'point': steps below move nothing.")
      .def_readwrite("partial", &IncrementalOptions::partial, "'point': only poses that moved take part again.")
      .def_readwrite("partial_neighbours", &IncrementalOptions::partial_neighbours, "'point': and their neighbours.")
      .def_readwrite("guard", &IncrementalOptions::guard, "'point': a step that raises chi2 is replaced.")
      .def_readwrite("budget_seconds", &IncrementalOptions::budget_seconds,
                     "Seconds a step may take; what does not fit is left to later steps. 0: no limit.")
      .def_readwrite("anchor_information", &IncrementalOptions::anchor_information,
                     "Of the anchor of the first pose; None: 1e8 where no priors fix the frame.")
      .def_readwrite("reweigh_tolerance", &IncrementalOptions::reweigh_tolerance,
                     "Share of chi2 by which a factor's cost changes before its weight is brought up to date.")
      .def_readwrite("restart", &IncrementalOptions::restart,
                     "'offset': where the map seems to sit in a wrong minimum, try a chordal relaxation of the graph.")
      .def_readwrite("threads", &IncrementalOptions::threads, "At most; the result is the same for any number.")
      .def_readwrite("report_cost", &IncrementalOptions::report_cost, "Fill in StepReport.actual_decrease.")
      .def_property(
          "robust", [](const IncrementalOptions& o) { return WordOf(o.robust.kernel); },
          [](IncrementalOptions& o, const std::string& word) { o.robust.kernel = FromWord<RobustKernel>(word); },
          "The cost of loops, which may be wrong: 'none', 'huber', 'cauchy', 'tukey', 'dcs' or 'gnc'.")
      .def_property(
          "robust_width", [](const IncrementalOptions& o) { return o.robust.width; },
          [](IncrementalOptions& o, double width) { o.robust.width = width; },
          "Where the kernel sets in, in standard deviations; 0: what one true loop in a hundred exceeds.")
      .def("__repr__",
           [](const py::object& self) {
             return OptionsText(self, py::cast(std::make_shared<IncrementalOptions>()), "");
           })
      .def(PickleOf<IncrementalOptions>("pickle IncrementalOptions"));
}

using Settings = py::class_<CompactSettings, std::shared_ptr<CompactSettings>>;

// A property of a member that both dimensions have, `member` being [](auto& options) -> auto& { ... }.
template <class Member>
void DefField(Settings& type, const char* name, const Member& member, const char* doc) {
  using Value = std::decay_t<decltype(member(std::declval<CompactOptions<SE2>&>()))>;
  type.def_property(
      name, [member](CompactSettings& s) { return std::visit([&](auto& o) -> Value { return member(o); }, s.options); },
      [member](CompactSettings& s, const Value& value) { std::visit([&](auto& o) { member(o) = value; }, s.options); },
      doc);
}
template <class Member>
void DefWordField(Settings& type, const char* name, const Member& member, const char* doc) {
  using E = std::decay_t<decltype(member(std::declval<CompactOptions<SE2>&>()))>;
  type.def_property(
      name,
      [member](CompactSettings& s) { return std::visit([&](auto& o) { return WordOf<E>(member(o)); }, s.options); },
      [member](CompactSettings& s, const std::string& word) {
        std::visit([&](auto& o) { member(o) = FromWord<E>(word); }, s.options);
      },
      doc);
}
template <class V>
void SetVector(V& to, const Array& array, const std::string& what) {
  if (array.ndim() != 1 || array.shape(0) != to.size()) {
    throw std::invalid_argument(what + ": expected shape (" + std::to_string(to.size()) + ",), got " + ShapeOf(array));
  }
  to = Eigen::Map<const V>(array.data());
}

void BindArrays(Settings& type) {
  type.def_property(
          "range",
          [](const CompactSettings& s) {
            return std::visit([](auto& o) { return ArrayOfVector(o.thresholds.range); }, s.options);
          },
          [](CompactSettings& s, const Array& range) {
            std::visit([&](auto& o) { SetVector(o.thresholds.range, range, "range"); }, s.options);
          },
          "Sensor range [x, y, angle] or [x, y, z, angle], metres and radians, in the frame of the pose that is seen "
          "from. "
          "A copy.")
      .def_property(
          "link_covariance",
          [](const CompactSettings& s) {
            return std::visit([](auto& o) { return ArrayOfMatrix(o.thresholds.link_covariance); }, s.options);
          },
          [](CompactSettings& s, const Array& covariance) {
            std::visit(
                [&](auto& o) {
                  o.thresholds.link_covariance =
                      MatrixFrom<std::decay_t<decltype(o.thresholds.link_covariance)>::RowsAtCompileTime>(
                          covariance, "link_covariance");
                },
                s.options);
          },
          "(d, d), or (d,) for its diagonal, d = 3 or 6: covariance expected of a registration; tangent order "
          "[translation, "
          "rotation], metres and radians, body frame of the newer pose. A copy.")
      .def_property(
          "view_axis",
          [](const CompactSettings& s) {
            return std::visit([](auto& o) { return ArrayOfVector(o.distance.view_axis); }, s.options);
          },
          [](CompactSettings& s, const Array& axis) {
            std::visit([&](auto& o) { SetVector(o.distance.view_axis, axis, "view_axis"); }, s.options);
          },
          "(3,): the sensor's view direction in the body frame, in space. A copy.");
}

void BindSearch(Settings& type) {
  DefField(
      type, "probability", [](auto& o) -> auto& { return o.thresholds.probability; },
      "Every dimension must be in range with more than this.");
  DefField(
      type, "plausible_quantile", [](auto& o) -> auto& { return o.plausible_quantile; },
      "A pose is a candidate, too, if the range meets the ellipsoid that holds the displacement with this "
      "probability.");
  DefField(
      type, "max_registrations", [](auto& o) -> auto& { return o.max_registrations; },
      "Registrations per pose, at most; the most information that can be expected of one comes first.");
  DefWordField(
      type, "record", [](auto& o) -> auto& { return o.record; },
      "What a Decision keeps of the search: 'none' (counts), 'decisions' (what was registered) or 'candidates' (the "
      "best of the others too).");
}

void BindSelection(Settings& type) {
  DefField(
      type, "min_loop_gain", [](auto& o) -> auto& { return o.thresholds.min_loop_gain; },
      "A link is kept if it adds more, nats.");
  DefField(
      type, "min_pose_gain", [](auto& o) -> auto& { return o.thresholds.min_pose_gain; },
      "A pose is kept if the least informative possible link would add more, nats, or if a loop closes.");
  DefWordField(
      type, "angle", [](auto& o) -> auto& { return o.distance.angle; },
      "The angle of range in space: 'view', between the view directions, or 'rotation', its length.");
  DefWordField(
      type, "composition", [](auto& o) -> auto& { return o.composition; },
      "Order of the covariances of chains over dropped poses: 'first' or 'fourth'.");
  DefField(
      type, "keep_poses", [](auto& o) -> auto& { return o.budget.keep_poses; },
      "Share of the poses that the map keeps in the long run: min_pose_gain is where the run starts, and follows.");
  DefField(
      type, "keep_links", [](auto& o) -> auto& { return o.budget.keep_links; },
      "The same of the loops that come measured or are registered.");
  DefField(
      type, "poses_per_area", [](auto& o) -> auto& { return o.budget.poses_per_area; },
      "Kept poses per square as wide as the greatest range that the robot has been in; not with keep_poses.");
  DefField(
      type, "error", [](auto& o) -> auto& { return o.budget.error; },
      "How many times the expected position error of a map with all loops that of the map may be, above 1, as "
      "covariances tell; alone.");
  DefField(
      type, "min_variance_drop", [](auto& o) -> auto& { return o.min_variance_drop; },
      "Strategy 'bounded': the share of the expected squared position error that a link must take from the map besides "
      "telling it enough nats; 0: not asked.");
  DefField(
      type, "retire_share", [](auto& o) -> auto& { return o.retire_share; },
      "Strategy 'bounded': as the map grows kept poses retire whose removal loses no more than this share of "
      "min_loop_gain; 0: none.");
  DefField(
      type, "most_dropped", [](auto& o) -> auto& { return o.most_dropped; },
      "So many of the newest dropped poses are remembered, and those that the chains of others lead through: memory "
      "then grows with the map alone. None: all.");
  DefField(
      type, "innovation_quantile", [](auto& o) -> auto& { return o.innovation_quantile; },
      "A link is refused whose innovation a correct one exceeds with less than the remaining probability. None: no "
      "test.");
  DefField(
      type, "consensus", [](auto& o) -> auto& { return o.consensus; },
      "So many refused links that agree with each other are right after all; at least 2.");
}

void BindCompactOptions(py::module_& module) {
  Settings type(module, "CompactOptions",
                "What compact pose SLAM keeps. Thresholds.options() fills it from a sample of a run.");
  type.def(py::init([](int dimension, const py::kwargs& keywords) {
             const auto settings = ForDimension(dimension, [](auto origin) {
               return std::make_shared<CompactSettings>(CompactSettings{CompactOptions<decltype(origin)>()});
             });
             SetAttributes(py::cast(settings), keywords);
             return settings;
           }),
           py::arg("dimension"), "dimension: 2 or 3. Any attribute can be given by keyword.")
      .def_property_readonly(
          "dimension", [](const CompactSettings& s) { return DimensionOf(s.options); }, "2 or 3.");
  DefWordField(
      type, "strategy", [](auto& o) -> auto& { return o.strategy; },
      "'bounded' (as many poses and links as the area needs; the default), 'fpfl' (few poses, few links), 'apfl' (all "
      "poses, few links), 'apal' (all), 'rfpfl' (as few as fpfl, drawn at random).");
  BindArrays(type);
  BindSearch(type);
  BindSelection(type);
  type.def_property(
      "solver",
      [](const CompactSettings& s) {
        return std::visit([](auto& o) { return std::make_shared<IncrementalOptions>(o.solver); }, s.options);
      },
      [](CompactSettings& s, const IncrementalOptions& solver) {
        std::visit([&](auto& o) { o.solver = solver; }, s.options);
      },
      "IncrementalOptions of the map. A copy: assign to change it.");
  type.def("__repr__",
           [](const py::object& self) {
             const int dimension = DimensionOf(self.cast<const CompactSettings&>().options);
             const auto standard = ForDimension(dimension, [](auto origin) {
               return std::make_shared<CompactSettings>(CompactSettings{CompactOptions<decltype(origin)>()});
             });
             return OptionsText(self, py::cast(standard), std::to_string(dimension));
           })
      .def(PickleOf<CompactSettings>(
          "pickle CompactOptions", [](const CompactSettings& s) { return s.options; },
          [](Either<CompactOptions> options) { return CompactSettings{std::move(options)}; }));
}

}  // namespace

void BindOptions(py::module_& module) {
  BindIncrementalOptions(module);
  BindCompactOptions(module);
}

}  // namespace terse::python
