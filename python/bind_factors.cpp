// Measurements as Python objects.

#include <pybind11/stl.h>

#include "bindings.h"
#include "pickling.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

template <class Pose, class Measurement>
Measurement Checked(const Measurement& measurement) {
  const std::string defect = FindDefect<Pose>(Factor<Pose>(measurement));
  if (!defect.empty()) throw std::invalid_argument(defect);
  return measurement;
}

RelativePose MakeRelativePose(std::int64_t from, std::int64_t to, const Array& T,
                              const std::optional<Array>& information, const std::optional<Array>& covariance) {
  return ForDimension(DimensionOfPose(T, "T_from_to"), [&](auto origin) {
    using Pose = decltype(origin);
    return RelativePose{Checked<Pose>(RelativePoseFactor<Pose>{PoseId{from}, PoseId{to}, PoseFrom<Pose>(T, "T_from_to"),
                                                               InformationFrom<Pose::kDof>(information, covariance)})};
  });
}

PosePrior MakePosePrior(std::int64_t id, const Array& T, const std::optional<Array>& information,
                        const std::optional<Array>& covariance) {
  return ForDimension(DimensionOfPose(T, "T_world_body"), [&](auto origin) {
    using Pose = decltype(origin);
    return PosePrior{Checked<Pose>(PosePriorFactor<Pose>{PoseId{id}, PoseFrom<Pose>(T, "T_world_body"),
                                                         InformationFrom<Pose::kDof>(information, covariance)})};
  });
}

PositionPrior MakePositionPrior(std::int64_t id, const Array& p, const std::optional<Array>& information,
                                const std::optional<Array>& covariance, const std::optional<Array>& lever) {
  if (p.ndim() != 1 || (p.shape(0) != 2 && p.shape(0) != 3)) {
    throw std::invalid_argument("p_world: expected shape (2,) or (3,), got " + ShapeOf(p));
  }
  if (lever && (lever->ndim() != 1 || lever->shape(0) != p.shape(0))) {
    throw std::invalid_argument("p_body: expected the shape of p_world, got " + ShapeOf(*lever));
  }
  return ForDimension(static_cast<int>(p.shape(0)), [&](auto origin) {
    using Pose = decltype(origin);
    PositionPriorFactor<Pose> prior{PoseId{id}, typename Pose::Position(Eigen::Map<const Vector<Pose::kDim>>(p.data())),
                                    InformationFrom<Pose::kDim>(information, covariance)};
    if (lever) prior.p_body = Eigen::Map<const Vector<Pose::kDim>>(lever->data());
    return PositionPrior{Checked<Pose>(prior)};
  });
}

// What all three have.
template <class Wrapped>
void BindCommon(py::class_<Wrapped>& type, const std::string& name, const char* shape) {
  type.def_property_readonly(
          "dimension", [](const Wrapped& w) { return DimensionOf(w.factor); }, "2 or 3.")
      .def_property_readonly(
          "information",
          [](const Wrapped& w) {
            return std::visit([](const auto& f) { return ArrayOfMatrix(f.information); }, w.factor);
          },
          (std::string("The inverse of the covariance, ") + shape + ". A copy.").c_str())
      .def(PickleOf<Wrapped>(
          "pickle " + name, [](const Wrapped& w) { return w.factor; }, [](auto factor) { return Wrapped{factor}; }));
}

void BindRelativePose(py::module_& module) {
  py::class_<RelativePose> type(module, "RelativePose",
                                "A measured T_from_to = T_world_from^-1 T_world_to: odometry or a loop closure.\n\n"
                                "The residual is Log(T_from_to^-1 T_world_from^-1 T_world_to).");
  type.def(py::init(&MakeRelativePose), py::arg("from_id"), py::arg("to_id"), py::arg("T_from_to"), py::kw_only(),
           py::arg("information") = py::none(), py::arg("covariance") = py::none(),
           "T_from_to: [x, y, theta] or (3, 3) in the plane, [x, y, z, qx, qy, qz, qw] or (4, 4) in space; metres and "
           "radians.\n"
           "information, covariance: exactly one of them, (d, d) or (d,) for its diagonal, d = 3 or 6; tangent order "
           "[translation, rotation], metres and radians, in the frame of to_id's body.");
  type.def_property_readonly(
          "from_id", [](const RelativePose& w) { return std::visit([](auto& f) { return f.from.value; }, w.factor); },
          "Id of the pose that is seen from.")
      .def_property_readonly(
          "to_id", [](const RelativePose& w) { return std::visit([](auto& f) { return f.to.value; }, w.factor); },
          "Id of the pose that is seen.")
      .def_property_readonly(
          "T_from_to",
          [](const RelativePose& w) { return std::visit([](auto& f) { return ArrayOf(f.T_from_to); }, w.factor); },
          "The measurement, (3,) or (7,). A copy.")
      .def("__repr__", [](const RelativePose& w) {
        return std::visit(
            [](auto& f) {
              return "<terse.RelativePose " + std::to_string(f.from.value) + " -> " + std::to_string(f.to.value) +
                     ": " + PoseText(f.T_from_to) + ">";
            },
            w.factor);
      });
  BindCommon(type, "RelativePose", "(d, d), d = 3 or 6; tangent order [translation, rotation], body frame of to_id");
}

void BindPriors(py::module_& module) {
  py::class_<PosePrior> pose(module, "PosePrior",
                             "A measured T_world_body of one pose. The residual is Log(measured^-1 T_world_body).");
  pose.def(py::init(&MakePosePrior), py::arg("pose_id"), py::arg("T_world_body"), py::kw_only(),
           py::arg("information") = py::none(), py::arg("covariance") = py::none(),
           "T_world_body: [x, y, theta] or (3, 3) in the plane, [x, y, z, qx, qy, qz, qw] or (4, 4) in space.\n"
           "information, covariance: exactly one, (d, d) or (d,) for its diagonal, d = 3 or 6; tangent order "
           "[translation, rotation], metres and radians, body frame.")
      .def_property_readonly(
          "pose_id", [](const PosePrior& w) { return std::visit([](auto& f) { return f.pose.value; }, w.factor); },
          "Id of the pose.")
      .def_property_readonly(
          "T_world_body",
          [](const PosePrior& w) { return std::visit([](auto& f) { return ArrayOf(f.T_world_body); }, w.factor); },
          "The measurement, (3,) or (7,). A copy.")
      .def("__repr__", [](const PosePrior& w) {
        return std::visit(
            [](auto& f) {
              return "<terse.PosePrior on " + std::to_string(f.pose.value) + ": " + PoseText(f.T_world_body) + ">";
            },
            w.factor);
      });
  BindCommon(pose, "PosePrior", "(d, d), d = 3 or 6; tangent order [translation, rotation], body frame");

  py::class_<PositionPrior> position(module, "PositionPrior",
                                     "Where a point of the body was measured in the world, as by GNSS. The residual, "
                                     "T_world_body p_body - p_world, is in the world frame.");
  position
      .def(py::init(&MakePositionPrior), py::arg("pose_id"), py::arg("p_world"), py::kw_only(),
           py::arg("information") = py::none(), py::arg("covariance") = py::none(), py::arg("p_body") = py::none(),
           "p_world: (2,) or (3,), metres. p_body: the point, in the body's frame, as of an antenna; the body's origin "
           "if it is not given.\n"
           "information, covariance: exactly one, (2, 2) or (3, 3), or its diagonal; world frame, metres.")
      .def_property_readonly(
          "pose_id", [](const PositionPrior& w) { return std::visit([](auto& f) { return f.pose.value; }, w.factor); },
          "Id of the pose.")
      .def_property_readonly(
          "p_world",
          [](const PositionPrior& w) { return std::visit([](auto& f) { return ArrayOfVector(f.p_world); }, w.factor); },
          "The measurement, (2,) or (3,), metres. A copy.")
      .def_property_readonly(
          "p_body",
          [](const PositionPrior& w) { return std::visit([](auto& f) { return ArrayOfVector(f.p_body); }, w.factor); },
          "The point that was measured, in the body's frame, metres. A copy.")
      .def("__repr__", [](const PositionPrior& w) {
        return std::visit(
            [](auto& f) {
              return "<terse.PositionPrior on " + std::to_string(f.pose.value) + ": " + NumbersText(f.p_world) + ">";
            },
            w.factor);
      });
  BindCommon(position, "PositionPrior", "(2, 2) or (3, 3), world frame");
}

}  // namespace

template <class Pose>
Factor<Pose> FactorFrom(py::handle object) {
  if (py::isinstance<RelativePose>(object)) {
    return Expect<RelativePoseFactor<Pose>>(object.cast<const RelativePose&>().factor, "measurement");
  }
  if (py::isinstance<PosePrior>(object)) {
    return Expect<PosePriorFactor<Pose>>(object.cast<const PosePrior&>().factor, "prior");
  }
  if (py::isinstance<PositionPrior>(object)) {
    return Expect<PositionPriorFactor<Pose>>(object.cast<const PositionPrior&>().factor, "prior");
  }
  throw py::type_error("expected a RelativePose, PosePrior or PositionPrior, got " +
                       py::repr(py::type::handle_of(object)).cast<std::string>());
}

template <class Pose>
std::vector<Factor<Pose>> FactorsFrom(const py::iterable& objects) {
  std::vector<Factor<Pose>> factors;
  for (const py::handle object : objects) factors.push_back(FactorFrom<Pose>(object));
  return factors;
}

template <class Pose>
py::object ObjectOf(const Factor<Pose>& factor) {
  if (const auto* relative = std::get_if<RelativePoseFactor<Pose>>(&factor)) return py::cast(RelativePose{*relative});
  if (const auto* prior = std::get_if<PosePriorFactor<Pose>>(&factor)) return py::cast(PosePrior{*prior});
  return py::cast(PositionPrior{std::get<PositionPriorFactor<Pose>>(factor)});
}

void BindFactors(py::module_& module) {
  BindRelativePose(module);
  BindPriors(module);
}

#define TERSE_INSTANTIATE(Pose)                                              \
  template Factor<Pose> FactorFrom<Pose>(py::handle);                        \
  template std::vector<Factor<Pose>> FactorsFrom<Pose>(const py::iterable&); \
  template py::object ObjectOf<Pose>(const Factor<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::python
