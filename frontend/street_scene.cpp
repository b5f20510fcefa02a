#include "street_scene.h"

#include <algorithm>
#include <cmath>

#include "street_paint.h"
#include "street_random.h"

namespace terse {
namespace {

using Point = Vector<2>;

const Vector<3> kDown = {0, 0, -1};

Vector<3> InSpace(const Point& p, double z) { return {p.x(), p.y(), z}; }

// 1 where road and walls show next to nothing, 0 elsewhere, between them over a few metres.
double BlankAt(const StreetSceneOptions& options, const StreetPath& path, double s) {
  if (!options.featureless_stretches) return 0;
  const double length = path.Length(), half = std::min(9.0, length / 20);
  double blank = 0;
  for (const double middle : {0.31 * length, 0.73 * length}) {
    blank = std::max(blank, std::clamp((half - std::abs(s - middle)) / 2.0, 0.0, 1.0));
  }
  return blank;
}

}  // namespace

// Puts things along the road. `side` is +1 on the left, -1 on the right; `aside` metres from the middle of the road.
class StreetBuilder {
 public:
  StreetBuilder(StreetScene& scene, const StreetSceneOptions& options)
      : scene_(scene), path_(scene.path_), options_(options), random_(HashMix(options.seed, 100)) {}

  void Build() {
    AddSky();
    const std::size_t sky = scene_.polygons_.size();
    AddGround();
    for (const int side : {-1, 1}) {
      AddFacades(side);
      AddAlong(9.0, 0.65, [&](double s) { AddCar(s, side); });
      AddAlong(13.0, 0.7, [&](double s) { AddTree(s, side); });
      AddAlong(17.0, 0.9, [&](double s) { AddPost(s, side); });
    }
    if (options_.twins) AddTwins(sky);
  }

 private:
  using Painter = void (*)(StreetCanvas&, std::uint64_t);

  double Blank(double s) const { return BlankAt(options_, path_, s); }
  // Of the path, up to which things stand at it.
  double End() const { return options_.twins ? path_.Length() / 2 : path_.Length(); }
  // Of the block.
  Point Middle() const {
    const StreetPoint opposite = path_.At(path_.Length() / 2);
    return Point(opposite.x, opposite.y) / 2;
  }

  // Of all polygons from this one on.
  void AddTwins(std::size_t first) {
    const Vector<3> middle = InSpace(Middle(), 0);
    const auto turned = [](const Vector<3>& v) { return Vector<3>(-v.x(), -v.y(), v.z()); };
    for (std::size_t k = first, end = scene_.polygons_.size(); k < end; ++k) {
      StreetPolygon twin = scene_.polygons_[k];
      twin.origin = middle + turned(twin.origin - middle);
      twin.s_axis = turned(twin.s_axis);
      twin.t_axis = turned(twin.t_axis);
      scene_.polygons_.push_back(twin);
    }
  }

  Point At(double s, double left) const {
    const StreetPoint p = path_.At(s);
    const double d = left + kRoadMiddle;
    return {p.x - d * std::sin(p.heading), p.y + d * std::cos(p.heading)};
  }

  const StreetTexture* Texture(double width, double height, double texels_per_metre, StreetTexture::Painter painter) {
    scene_.textures_.push_back(
        std::make_unique<StreetTexture>(width, height, texels_per_metre, options_.contrast, std::move(painter)));
    return scene_.textures_.back().get();
  }
  const StreetTexture* Texture(double width, double height, Painter paint, std::uint64_t seed) {
    return Texture(width, height, options_.texels_per_metre,
                   [paint, seed](StreetCanvas& canvas) { paint(canvas, seed); });
  }

  void AddRectangle(const Vector<3>& origin, const Vector<3>& s_axis, const Vector<3>& t_axis, double width,
                    double height, const StreetTexture* texture) {
    scene_.polygons_.push_back(
        {origin, s_axis, t_axis, {Point(0, 0), Point(width, 0), Point(width, height), Point(0, height)}, texture});
  }

  // A vertical wall over the line from a to b, which are left and right for who looks at it.
  void AddWall(const Point& a, const Point& b, double bottom, double top, Painter paint) {
    AddWall(a, b, bottom, top, paint, random_.Bits());
  }
  void AddWall(const Point& a, const Point& b, double bottom, double top, Painter paint, std::uint64_t seed) {
    const double width = (b - a).norm();
    if (width < 0.05) return;
    AddRectangle(InSpace(a, top), InSpace((b - a) / width, 0), kDown, width, top - bottom,
                 Texture(width, top - bottom, paint, seed));
  }

  // An upright box round `centre`, its length along `heading`, with a lid. All sides have the same seed, so that a car
  // has one colour.
  void AddBox(const Point& centre, double heading, double length, double width, double bottom, double top,
              Painter paint) {
    const Point along(std::cos(heading), std::sin(heading)), across(-along.y(), along.x());
    const Point l = length / 2 * along, w = width / 2 * across;
    const Point corners[4] = {centre - l - w, centre + l - w, centre + l + w, centre - l + w};
    const std::uint64_t seed = random_.Bits();
    for (int k = 0; k < 4; ++k) AddWall(corners[k], corners[(k + 1) % 4], bottom, top, paint, seed);
    AddRectangle(InSpace(corners[0], top), InSpace(along, 0), InSpace(across, 0), length, width,
                 Texture(length, width, paint, seed));
  }

  void AddSky() {
    constexpr double kHalf = 3000, kHeight = 150;
    AddRectangle({-kHalf, -kHalf, kHeight}, Vector<3>::UnitX(), Vector<3>::UnitY(), 2 * kHalf, 2 * kHalf,
                 Texture(2 * kHalf, 2 * kHalf, 1 / 12.0,
                         [seed = random_.Bits()](StreetCanvas& canvas) { PaintSky(canvas, seed); }));
  }

  // Square tiles wherever the road is near.
  void AddGround() {
    constexpr double kTile = 8, kReach = 26;
    double low_x = 0, high_x = 0, low_y = 0, high_y = 0;
    for (double s = 0; s < path_.Length(); s += 1) {
      const StreetPoint p = path_.At(s);
      low_x = std::min(low_x, p.x), high_x = std::max(high_x, p.x);
      low_y = std::min(low_y, p.y), high_y = std::max(high_y, p.y);
    }
    const std::uint64_t seed = random_.Bits();
    // Tiles of twins are those below the middle, from where they are turned.
    const Point first = options_.twins ? Middle() : Point(0, 0);
    const double top = options_.twins ? first.y() - kTile / 2 : high_y + kReach;
    const auto low = [&](double edge, double from) {
      return from + kTile * std::floor((edge - kReach - from) / kTile);
    };
    for (double x = low(low_x, first.x()); x < high_x + kReach; x += kTile) {
      for (double y = low(low_y, first.y()); y < top; y += kTile) {
        if (std::abs(path_.Nearest(x + kTile / 2, y + kTile / 2).left) > kReach) continue;
        const auto paint = [this_path = &path_, options = options_, seed, x, y](StreetCanvas& canvas) {
          const auto blank = [&](double s) { return BlankAt(options, *this_path, s); };
          PaintGround(canvas, seed, *this_path, x, y, blank);
        };
        AddRectangle({x, y, 0}, Vector<3>::UnitX(), Vector<3>::UnitY(), kTile, kTile,
                     Texture(kTile, kTile, options_.texels_per_metre, paint));
      }
    }
  }

  // Houses wall to wall or with gaps, each at its own distance from the road, and a wall or hedge across the gaps.
  void AddFacades(int side) {
    for (double s = 0; s < End();) {
      const double width = std::min(random_.Uniform(5, 11), End() - s + 0.5);
      const bool blank = Blank(s + width / 2) > 0, gap = !blank && random_.Chance(0.18);
      const double aside = blank ? 8.2 : kSidewalkEdge + random_.Uniform(0.3, 2.8), depth = 6;
      Point a = At(s, side * aside), b = At(s + width, side * aside);
      if (side < 0) std::swap(a, b);
      if (gap) {
        AddWall(a, b, 0, random_.Uniform(0.8, 2.2), random_.Chance(0.5) ? PaintLeaves : PaintFacade);
        const double back = side * (aside + 10);
        const Point start = At(s - 2, back), end = At(s + width + 2, back);
        AddWall(side > 0 ? start : end, side > 0 ? end : start, 0, random_.Uniform(5, 9), PaintFacade);
      } else {
        const double height = random_.Uniform(5.5, 11);
        const Painter paint = blank ? PaintBlankWall : PaintFacade;
        AddWall(a, b, 0, height, paint);
        const Point along = (b - a).normalized(), back = depth * Point(-along.y(), along.x());
        AddWall(a + back, a, 0, height, paint);
        AddWall(b, b + back, 0, height, paint);
      }
      s += width;
    }
  }

  template <class Add>
  void AddAlong(double spacing, double chance, const Add& add) {
    for (double s = random_.Uniform(0, spacing); s < End() - spacing / 3; s += spacing * random_.Uniform(0.7, 1.3)) {
      if (random_.Chance(chance) && Blank(s) == 0) add(s);
    }
  }

  void AddCar(double s, int side) {
    const double aside = side * random_.Uniform(4.15, 4.35),
                 heading = path_.At(s).heading + random_.Uniform(-0.04, 0.04);
    const double length = random_.Uniform(3.6, 4.7), width = random_.Uniform(1.6, 1.8);
    const double belt = random_.Uniform(0.8, 1.1), roof = belt + random_.Uniform(0.45, 0.9);
    const Point at = At(s, aside), along(std::cos(heading), std::sin(heading));
    AddBox(at, heading, length, width, 0.12, belt, PaintCar);
    AddBox(at - random_.Uniform(0, 0.4) * along, heading, length * random_.Uniform(0.5, 0.8), width - 0.15, belt, roof,
           PaintCarWindows);
  }

  void AddPost(double s, int side) {
    const Point at = At(s, side * 5.6);
    const double heading = path_.At(s).heading;
    AddBox(at, heading, 0.16, 0.16, 0, random_.Uniform(3, 7), PaintPost);
    if (random_.Chance(0.6)) {  // a sign, facing those who come
      const double top = random_.Uniform(2.3, 3.2), size = random_.Uniform(0.5, 0.9);
      const Point across(-std::sin(heading), std::cos(heading)), front(std::cos(heading), std::sin(heading));
      const Point centre = at - 0.1 * front;
      AddWall(centre + size / 2 * across, centre - size / 2 * across, top - size, top, PaintSign);
    }
    if (random_.Chance(0.5))
      AddBox(At(s + 1.2, side * 6.4), heading, 0.5, 0.5, 0, random_.Uniform(0.7, 1.2), PaintSign);
  }

  // A trunk and a crown like a rough ball.
  void AddTree(double s, int side) {
    const Point at = At(s, side * random_.Uniform(6.0, 7.0));
    const double radius = random_.Uniform(1.0, 1.9), middle = random_.Uniform(3.0, 4.2),
                 trunk = random_.Uniform(0.2, 0.4);
    AddBox(at, random_.Uniform(0, 1.5), trunk, trunk, 0, middle, PaintPost);
    constexpr int kAround = 9, kRings = 5;
    const StreetTexture* leaves = Texture(2 * M_PI * radius, M_PI * radius, PaintLeaves, random_.Bits());
    Vector<3> nodes[kRings + 1][kAround];
    for (int ring = 0; ring <= kRings; ++ring) {
      for (int k = 0; k < kAround; ++k) {
        const double up = M_PI * (0.5 - static_cast<double>(ring) / kRings), round = 2 * M_PI * k / kAround;
        const double r = radius * random_.Uniform(0.75, 1.15);
        nodes[ring][k] = InSpace(at, middle) +
                         r * Vector<3>(std::cos(up) * std::cos(round), std::cos(up) * std::sin(round), std::sin(up));
      }
    }
    for (int ring = 0; ring < kRings; ++ring) {
      for (int k = 0; k < kAround; ++k) {
        const Point texture_at(2 * M_PI * radius * k / kAround, M_PI * radius * ring / kRings);
        const int next = (k + 1) % kAround;
        AddTriangle(nodes[ring][k], nodes[ring][next], nodes[ring + 1][k], texture_at, leaves);
        AddTriangle(nodes[ring + 1][next], nodes[ring + 1][k], nodes[ring][next], texture_at, leaves);
      }
    }
  }

  // `texture_at`: where a lies in the texture.
  void AddTriangle(const Vector<3>& a, const Vector<3>& b, const Vector<3>& c, const Point& texture_at,
                   const StreetTexture* texture) {
    const Vector<3> s_axis = (b - a).normalized();
    const Vector<3> normal = s_axis.cross(c - a);
    if (normal.norm() < 1e-3) return;
    const Vector<3> t_axis = normal.normalized().cross(s_axis);
    const Vector<3> origin = a - texture_at.x() * s_axis - texture_at.y() * t_axis;
    const Point third = texture_at + Point((c - a).dot(s_axis), (c - a).dot(t_axis));
    scene_.polygons_.push_back(
        {origin, s_axis, t_axis, {texture_at, texture_at + Point((b - a).norm(), 0), third, third}, texture});
  }

  StreetScene& scene_;
  const StreetPath& path_;
  const StreetSceneOptions options_;
  StreetRandom random_;
};

StreetScene::StreetScene(const StreetPath& path, const StreetSceneOptions& options) : path_(path) {
  StreetBuilder(*this, options).Build();
}

}  // namespace terse
