// Maps of several robots or sessions as one.

#include <pybind11/stl.h>

#include <filesystem>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/compact/map_file.h"
#include "terse/compact/map_links.h"
#include "terse/compact/merge.h"
#include "terse/compact/thresholds_file.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

using Path = std::filesystem::path;

struct Link {
  Either<MapLink> link;
};

Link MakeLink(int from_map, std::int64_t from, int to_map, std::int64_t to, const Array& T,
              const std::optional<Array>& information, const std::optional<Array>& covariance) {
  return ForDimension(DimensionOfPose(T, "T_from_to"), [&](auto origin) {
    using Pose = decltype(origin);
    MapLink<Pose> link{from_map, to_map, {}};
    link.measured = {PoseId{from}, PoseId{to}, PoseFrom<Pose>(T, "T_from_to"),
                     InformationFrom<Pose::kDof>(information, covariance)};
    return Link{link};
  });
}

// A map as it was given. Folders are read, graphs solved, without the GIL.
struct GivenMap {
  std::string name;
  std::variant<Path, CompactMapFile, std::shared_ptr<const AnyPoseGraph>> what;
};

std::vector<GivenMap> GivenMaps(const py::sequence& maps) {
  std::vector<GivenMap> given;
  for (const py::handle map : maps) {
    const std::string name = "maps[" + std::to_string(given.size()) + "]";
    if (py::isinstance<CompactMapFile>(map)) {
      given.push_back({name, map.cast<const CompactMapFile&>()});
    } else if (py::isinstance<Graph>(map)) {
      given.push_back({name, map.cast<const Graph&>().Share()});
    } else {
      const Path path = py::module_::import("os").attr("fspath")(map).cast<Path>();
      given.push_back({path.string(), path});
    }
  }
  return given;
}

CompactMapFile MapFrom(const GivenMap& given, int threads) {
  if (const auto* file = std::get_if<CompactMapFile>(&given.what)) return *file;
  if (const auto* path = std::get_if<Path>(&given.what)) {
    if (!std::filesystem::is_directory(*path))
      throw FileError(given.name, 0, "not the folder of a run; a graph file is read by read_graph");
    return ReadCompactMap((*path / "graph.json").string());
  }
  return std::visit(
      [&](const auto& graph) {
        return CompactMapFile{MapOfGraph(graph, threads), {}, {}};
      },
      *std::get<std::shared_ptr<const AnyPoseGraph>>(given.what));
}

// `map`: of merged.map, with the scale of the first.
struct Joint {
  std::variant<std::shared_ptr<const Merged<SE2>>, std::shared_ptr<const Merged<SE3>>> result;
  InformationScale scale;
};

template <class F>
decltype(auto) Visit(const Joint& joint, const F& f) {
  return std::visit([&](const auto& result) -> decltype(auto) { return f(*result); }, joint.result);
}

using GivenLinks = std::variant<Path, std::vector<Link>>;

GivenLinks LinksFrom(const py::object& links) {
  if (py::isinstance<py::str>(links) || py::hasattr(links, "__fspath__"))
    return py::module_::import("os").attr("fspath")(links).cast<Path>();
  std::vector<Link> out;
  if (links.is_none()) return out;
  for (const py::handle link : py::iter(links)) {
    if (!py::isinstance<Link>(link)) throw py::type_error("links: expected a path or MapLink objects");
    out.push_back(link.cast<const Link&>());
  }
  return out;
}

template <class Pose>
Joint MergeFiles(const std::vector<GivenMap>& given, std::vector<CompactMapFile> files, const GivenLinks& links,
                 MergeOptions<Pose> options) {
  std::vector<MapToMerge<Pose>> maps;
  std::vector<InformationScale> scales;
  for (std::size_t k = 0; k < files.size(); ++k) {
    maps.push_back({given[k].name, std::get<CompactMap<Pose>>(std::move(files[k].map))});
    scales.push_back(files[k].information_scale);
  }
  std::vector<MapLink<Pose>> between;
  if (const auto* path = std::get_if<Path>(&links)) {
    between = ReadMapLinks<Pose>(path->string(), maps);
  } else {
    for (const Link& link : std::get<std::vector<Link>>(links))
      between.push_back(Expect<MapLink<Pose>>(link.link, "links[" + std::to_string(between.size()) + "]"));
  }
  if (const auto* folder = std::get_if<Path>(&given[0].what); folder != nullptr && !options.thresholds) {
    const Path thresholds = *folder / "thresholds.json";
    if (std::filesystem::exists(thresholds)) options.thresholds = ReadThresholds<Pose>(thresholds.string());
  }
  return {std::make_shared<const Merged<Pose>>(Merge(maps, ScaleMapLinks(between, scales), options)), scales[0]};
}

Joint MergeMaps(const py::sequence& maps, const py::object& links,
                const std::optional<std::shared_ptr<CompactSettings>>& options, double retire_share,
                double pair_quantile, double link_quantile, int most_compared, int threads) {
  const std::vector<GivenMap> given = GivenMaps(maps);
  const GivenLinks between = LinksFrom(links);
  std::optional<Either<CompactOptions>> settings;  // a copy: nobody else changes it meanwhile
  if (options) settings = (*options)->options;
  const py::gil_scoped_release release;
  if (threads < 1) throw std::invalid_argument("threads must be 1 or more");
  std::vector<CompactMapFile> files;
  for (const GivenMap& map : given) {
    files.push_back(MapFrom(map, threads));
    const int dimension = DimensionOf(files.back().map), expected = DimensionOf(files[0].map);
    if (dimension != expected) ThrowDimension(map.name, dimension, expected);
  }
  if (files.size() < 2) throw std::invalid_argument("merging takes two maps or more");
  return ForDimension(DimensionOf(files[0].map), [&](auto origin) {
    using Pose = decltype(origin);
    MergeOptions<Pose> merge;
    merge.retire_share = retire_share;
    merge.pair_quantile = pair_quantile;
    merge.link_quantile = link_quantile;
    merge.most_compared = most_compared;
    merge.threads = threads;
    if (settings) merge.thresholds = Expect<CompactOptions<Pose>>(*settings, "options").thresholds;
    return MergeFiles<Pose>(given, std::move(files), between, std::move(merge));
  });
}

// Of one map and one link, as values.
struct Placed {
  std::string name, placement;
  std::int64_t id_offset = 0;
  py::object T_joint_map, covariance;
  int poses = 0, kept = 0, loops_out = 0;
};
template <class Pose>
Placed PlacedOf(const PlacedMap<Pose>& map) {
  const bool is_apart = map.placement == Placement::kApart;
  return {map.name,
          Name(map.placement),
          map.id_offset,
          is_apart ? py::object(py::none()) : py::object(ArrayOf(map.T_joint_map)),
          is_apart ? py::object(py::none()) : py::object(ArrayOfMatrix(map.covariance)),
          map.poses,
          map.kept,
          map.loops_out};
}

struct Judged {
  int from_map = 0, to_map = 0;
  std::int64_t from = 0, to = 0, joint_from = 0, joint_to = 0;
  std::string verdict;
  std::optional<int> agreeing;
  std::optional<double> innovation;
};
template <class Pose>
Judged JudgedOf(const MergedLink<Pose>& link) {
  Judged out{link.link.from_map,
             link.link.to_map,
             link.link.measured.from.value,
             link.link.measured.to.value,
             link.from.value,
             link.to.value,
             Name(link.verdict),
             {},
             {}};
  if (link.agreeing >= 0) out.agreeing = link.agreeing;
  if (link.verdict != MapLinkVerdict::kMapsApart) out.innovation = link.innovation;
  return out;
}

template <class Of>
auto Value(const Of& of) {
  return [of](const Joint& joint) { return Visit(joint, of); };
}

std::string Text(const Joint& joint) {
  return Visit(joint, [](const auto& r) {
    const auto accepted = std::count_if(r.links.begin(), r.links.end(),
                                        [](const auto& link) { return link.verdict == MapLinkVerdict::kAccepted; });
    const auto joined =
        std::count_if(r.maps.begin(), r.maps.end(), [](const auto& map) { return map.placement != Placement::kApart; });
    return "<terse.Merged: " + std::to_string(joined) + " of " + Counted(r.maps.size(), "map") + ", " +
           std::to_string(accepted) + " of " + Counted(r.links.size(), "link") + ", " +
           Counted(r.graph.Poses().size(), "pose") + " kept>";
  });
}

void BindLink(py::module_& module) {
  py::class_<Link>(module, "MapLink", "A measured T_from_to between poses of two maps that are to be merged.")
      .def(py::init(&MakeLink), py::arg("from_map"), py::arg("from_id"), py::arg("to_map"), py::arg("to_id"),
           py::arg("T_from_to"), py::kw_only(), py::arg("information") = py::none(), py::arg("covariance") = py::none(),
           "Pose to_id of maps[to_map] seen from pose from_id of maps[from_map], by the ids that they have there; "
           "dropped poses will do. Maps count from 0. information or covariance: (d, d), or (d,) for its diagonal.")
      .def_property_readonly(
          "dimension", [](const Link& l) { return DimensionOf(l.link); }, "2 or 3.")
      .def(PickleOf<Link>(
          "pickle MapLink", [](const Link& l) { return l.link; }, [](Either<MapLink> link) { return Link{link}; }))
      .def("__repr__", [](const Link& l) {
        return std::visit(
            [](const auto& link) {
              const auto end = [](int map, PoseId id) { return std::to_string(map) + ":" + std::to_string(id.value); };
              return "<terse.MapLink " + end(link.from_map, link.measured.from) + " -> " +
                     end(link.to_map, link.measured.to) + ">";
            },
            l.link);
      });
}

void BindPlacedMap(py::module_& module) {
  py::class_<Placed>(module, "PlacedMap", "Where a map lies in the joint one, and what holds it there.")
      .def_readonly("name", &Placed::name, "Its folder, or 'maps[k]'.")
      .def_readonly("id_offset", &Placed::id_offset, "What is added to its ids in the joint map.")
      .def_readonly("placement", &Placed::placement,
                    "What holds it: 'reference' (the joint frame is its own), 'links', 'unconfirmed' (one link, which "
                    "nothing confirms), 'datum' (absolute measurements), or 'apart': it is not in the joint map.")
      .def_readonly("T_joint_map", &Placed::T_joint_map,
                    "(3,) or (7,): where its own frame came to lie, by its first kept pose; None if it is apart.")
      .def_readonly("covariance", &Placed::covariance,
                    "(d, d): of its first kept pose, body frame, translation first, seen from the first pose of the "
                    "reference map, or absolute where absolute measurements say where the joint map is; None if apart.")
      .def_readonly("poses", &Placed::poses, "Poses that came with it.")
      .def_readonly("kept", &Placed::kept, "Of these in the joint map.")
      .def_readonly("loops_out", &Placed::loops_out, "Loops of its own that its optimum contradicts: left out.")
      .def("__repr__", [](const Placed& p) {
        return "<terse.PlacedMap " + p.name + ": " + p.placement + ", ids + " + std::to_string(p.id_offset) + ", " +
               std::to_string(p.kept) + " of " + Counted(p.poses, "pose") + " kept>";
      });
}

void BindMergedLink(py::module_& module) {
  py::class_<Judged>(module, "MergedLink", "What became of a link between maps.")
      .def_readonly("from_map", &Judged::from_map, "As it was given.")
      .def_readonly("from_id", &Judged::from, "As it was given.")
      .def_readonly("to_map", &Judged::to_map, "As it was given.")
      .def_readonly("to_id", &Judged::to, "As it was given.")
      .def_readonly("joint_from_id", &Judged::joint_from, "The pose of the merged maps that it was carried to.")
      .def_readonly("joint_to_id", &Judged::joint_to, "The same of its other end.")
      .def_readonly("verdict", &Judged::verdict,
                    "'accepted', 'inconsistent' (it contradicts the joint map, or what pairwise agrees) or "
                    "'maps_apart' (one of its maps is not in the joint one).")
      .def_readonly("agreeing", &Judged::agreeing,
                    "Of the links that it was compared with in pairs; None if it was not.")
      .def_readonly("innovation", &Judged::innovation,
                    "Squared Mahalanobis distance from the joint map without it; if accepted, of what is left. None "
                    "if its maps are apart.")
      .def("__repr__", [](const Judged& l) {
        return "<terse.MergedLink " + std::to_string(l.from_map) + ":" + std::to_string(l.from) + " -> " +
               std::to_string(l.to_map) + ":" + std::to_string(l.to) + ": " + l.verdict + ">";
      });
}

void BindJoint(py::module_& module) {
  py::class_<Joint>(module, "Merged", "Maps as one, and what became of the links between them.")
      .def_property_readonly(
          "dimension", [](const Joint& j) { return DimensionOf(j.result); }, "2 or 3.")
      .def_property_readonly("graph", Value([](const auto& r) { return Graph(r.graph); }),
                             "PoseGraph: kept poses and all that is measured, at the optimum; covariances of it cross "
                             "maps. A copy.")
      .def_property_readonly(
          "map",
          [](const Joint& j) {
            return Visit(j, [&](const auto& r) {
              return std::make_shared<CompactMapFile>(CompactMapFile{r.map, Strategy::kBounded, j.scale});
            });
          },
          "CompactMap: the same and the dropped poses, those of the first map last: its robot goes on in it. A copy.")
      .def_property_readonly(
          "options", Value([](const auto& r) {
            using Pose = std::decay_t<decltype(r.map.poses.front().T_world_body)>;
            CompactOptions<Pose> options;
            options.thresholds = r.thresholds;
            return std::make_shared<CompactSettings>(CompactSettings{options});
          }),
          "CompactOptions with the thresholds that poses retired by, for CompactPoseSlam.restore(merged.map, "
          "merged.options).")
      .def_property_readonly("maps", Value([](const auto& r) {
                               std::vector<Placed> out;
                               for (const auto& map : r.maps) out.push_back(PlacedOf(map));
                               return out;
                             }),
                             "PlacedMap objects, in the order given.")
      .def_property_readonly("links", Value([](const auto& r) {
                               std::vector<Judged> out;
                               for (const auto& link : r.links) out.push_back(JudgedOf(link));
                               return out;
                             }),
                             "MergedLink objects, likewise.")
      .def_property_readonly("retired", Value([](const auto& r) { return r.retired; }),
                             "RetiredPose objects, in the order in which they went.")
      .def_property_readonly("poses_before", Value([](const auto& r) { return r.poses_before; }),
                             "Kept poses, before any retired.")
      .def_property_readonly("chi2", Value([](const auto& r) { return r.chi2; }), "Of graph.")
      .def_property_readonly("chi2_before", Value([](const auto& r) { return r.chi2_before; }), "Before poses retired.")
      .def("__repr__", &Text);
}

}  // namespace

void BindMerge(py::module_& module) {
  BindLink(module);
  BindPlacedMap(module);
  BindMergedLink(module);
  BindJoint(module);
  const MergeOptions<SE2> defaults;
  module.def(
      "merge", &MergeMaps, py::arg("maps"), py::arg("links") = py::none(), py::kw_only(),
      py::arg("options") = py::none(), py::arg("retire_share") = defaults.retire_share,
      py::arg("pair_quantile") = defaults.pair_quantile, py::arg("link_quantile") = defaults.link_quantile,
      py::arg("most_compared") = defaults.most_compared, py::arg("threads") = defaults.threads,
      "Joins maps whose start relative to each other is unknown (Merged).\n\n"
      "maps: two or more, each the folder of a run, a CompactMap or a PoseGraph, which is solved (its information as "
      "it is: calibrate_information). The first one keeps its ids, and its robot can go on in the joint map.\n"
      "links: a file as the command merge reads it, or MapLink objects, some of which may be wrong. None: absolute "
      "measurements have to say where the maps are.\n"
      "options: CompactOptions whose thresholds poses retire by; None: those of the first map's folder, else a sample "
      "of the joint graph has them.\n"
      "retire_share: what a retiring pose may lose, as a share of the least gain of a link; 0: none retires.\n"
      "pair_quantile: of the chi-square distribution; two links that disagree by more do not agree. link_quantile: "
      "likewise of a link and the joint map.\n"
      "most_compared: links of two maps that are compared in pairs, at most.\n"
      "The result is the same for any number of threads. NumericalError if no two maps hold together, FileError. "
      "Without the GIL.");
}

}  // namespace terse::python
