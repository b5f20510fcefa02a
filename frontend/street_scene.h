#pragma once
// A street round a block: road, facades, parked cars, trees, lamp posts and signs, all of them convex plane polygons
// with at most four corners.
//
// World frame: x and y in the plane of the road, z up, metres. The driving line starts at the origin along x.

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "street_path.h"
#include "street_texture.h"
#include "terse/lie/types.h"

namespace terse {

struct StreetPolygon {
  Vector<3> origin;                  // of the texture: its top left corner
  Vector<3> s_axis, t_axis;          // unit vectors along its rows and columns
  std::array<Vector<2>, 4> corners;  // (s, t), metres, in order; a triangle repeats one
  const StreetTexture* texture = nullptr;
};

struct StreetSceneOptions {
  double contrast = 0.6;
  double texels_per_metre = 50;
  bool featureless_stretches = true;
  std::uint64_t seed = 1;
  bool twins = false;  // the street turned by half a turn about the middle of the block is the street
};

class StreetScene {
 public:
  StreetScene(const StreetPath& path, const StreetSceneOptions& options);
  StreetScene(const StreetScene&) = delete;
  StreetScene& operator=(const StreetScene&) = delete;
  const std::vector<StreetPolygon>& Polygons() const { return polygons_; }

 private:
  friend class StreetBuilder;
  StreetPath path_;
  std::vector<StreetPolygon> polygons_;
  std::vector<std::unique_ptr<StreetTexture>> textures_;
};

}  // namespace terse
