#include "street_renderer.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

namespace terse {
namespace {

constexpr double kNear = 0.2;  // metres
constexpr float kHaze = 205;   // where there is nothing
constexpr int kMostTaps = 4;   // along the foreshortened direction
constexpr std::int32_t kNothing = -1;

using Point = Vector<2>;

// a . (u, v, 1).
struct Affine {
  float u = 0, v = 0, one = 0;
  float At(float pixel_u, float pixel_v) const { return u * pixel_u + v * pixel_v + one; }
};

// A polygon as the camera sees it. On its plane 1/z and the texture's texels divided by z are affine in the pixel.
struct Projected {
  Affine inverse_z, s, t;
  std::vector<Point> outline;  // pixels
  const StreetTexture* texture = nullptr;
};

Affine ToAffine(const Vector<3>& a) {
  return {static_cast<float>(a.x()), static_cast<float>(a.y()), static_cast<float>(a.z())};
}

// Cut at the near plane; false if nothing of it is in the image.
bool Outline(const StreetPolygon& polygon, const StreetView& view, const SE3& T_camera_world,
             std::vector<Point>& outline) {
  const Vector<3> origin = T_camera_world * polygon.origin;
  const Vector<3> s_axis = T_camera_world.Rotation() * polygon.s_axis,
                  t_axis = T_camera_world.Rotation() * polygon.t_axis;
  std::array<Vector<3>, 4> p;
  for (std::size_t k = 0; k < 4; ++k) p[k] = origin + polygon.corners[k].x() * s_axis + polygon.corners[k].y() * t_axis;
  outline.clear();
  const auto add = [&](const Vector<3>& q) {
    outline.emplace_back(view.fx * q.x() / q.z() + view.cx, view.fy * q.y() / q.z() + view.cy);
  };
  for (std::size_t k = 0; k < 4; ++k) {
    const Vector<3>&a = p[k], &b = p[(k + 1) % 4];
    if (a.z() >= kNear) add(a);
    if ((a.z() >= kNear) != (b.z() >= kNear)) add(a + (kNear - a.z()) / (b.z() - a.z()) * (b - a));
  }
  if (outline.size() < 3) return false;
  Point low = outline[0], high = outline[0];
  for (const Point& q : outline) low = low.cwiseMin(q), high = high.cwiseMax(q);
  return high.x() > -1 && low.x() < view.width && high.y() > -1 && low.y() < view.height;
}

// The plane's point along the ray d = ((u - cx) / fx, (v - cy) / fy, 1) is z d with n . (z d - origin) = 0, so that
// 1/z = n . d / n . origin; and s / z = s_axis . (d - origin / z).
bool SetPlane(const StreetPolygon& polygon, const StreetView& view, const SE3& T_camera_world, Projected& out) {
  const Vector<3> origin = T_camera_world * polygon.origin;
  const Vector<3> s_axis = T_camera_world.Rotation() * polygon.s_axis,
                  t_axis = T_camera_world.Rotation() * polygon.t_axis;
  const Vector<3> normal = s_axis.cross(t_axis);
  const double distance = normal.dot(origin);
  if (std::abs(distance) < 1e-6) return false;  // seen from the edge
  const auto in_pixels = [&](const Vector<3>& a) {
    const double u = a.x() / view.fx, v = a.y() / view.fy;
    return Vector<3>(u, v, a.z() - u * view.cx - v * view.cy);
  };
  const Vector<3> inverse_z = normal / distance;
  const double scale = polygon.texture->TexelsPerMetre();
  out.inverse_z = ToAffine(in_pixels(inverse_z));
  out.s = ToAffine(in_pixels(scale * (s_axis - s_axis.dot(origin) * inverse_z)));
  out.t = ToAffine(in_pixels(scale * (t_axis - t_axis.dot(origin) * inverse_z)));
  out.texture = polygon.texture;
  return true;
}

std::vector<Projected> Project(const StreetScene& scene, const StreetView& view, const SE3& T_world_camera) {
  const SE3 T_camera_world = T_world_camera.Inverse();
  std::vector<Projected> out;
  Projected projected;
  for (const StreetPolygon& polygon : scene.Polygons()) {
    if (Outline(polygon, view, T_camera_world, projected.outline) &&
        SetPlane(polygon, view, T_camera_world, projected)) {
      out.push_back(projected);
    }
  }
  return out;
}

// Which polygon is nearest at each sample. Sample k of a row or column lies at pixel (k + 0.5) / per_pixel - 0.5.
struct Visibility {
  cv::Mat1f inverse_z;
  cv::Mat1i polygon;
};

// The nearer of what is there and this polygon, in one row of samples. Written without branches for the compiler.
void Cover(float* inverse_z, std::int32_t* ids, int count, float start, float step, std::int32_t id) {
  for (int k = 0; k < count; ++k) {
    const float here = start + step * static_cast<float>(k);
    const bool nearer = here > inverse_z[k];
    inverse_z[k] = nearer ? here : inverse_z[k];
    ids[k] = nearer ? id : ids[k];
  }
}

// Where the row v cuts the convex outline.
bool Span(const std::vector<Point>& outline, double v, double& low, double& high) {
  low = 1e30, high = -1e30;
  for (std::size_t k = 0; k < outline.size(); ++k) {
    const Point &a = outline[k], &b = outline[(k + 1) % outline.size()];
    if ((a.y() <= v) == (b.y() <= v)) continue;
    const double u = a.x() + (v - a.y()) / (b.y() - a.y()) * (b.x() - a.x());
    low = std::min(low, u), high = std::max(high, u);
  }
  return low < high;
}

Visibility FindVisible(const std::vector<Projected>& polygons, const StreetView& view, int per_pixel) {
  Visibility out{cv::Mat1f(view.height * per_pixel, view.width * per_pixel, 0.0f),
                 cv::Mat1i(view.height * per_pixel, view.width * per_pixel, kNothing)};
  const auto to_sample = [&](double pixel) { return (pixel + 0.5) * per_pixel - 0.5; };
  const auto to_pixel = [&](int sample) { return (sample + 0.5) / per_pixel - 0.5; };
  const auto first_from = [&](double pixel, int end) {
    return static_cast<int>(std::clamp(std::ceil(to_sample(pixel)), 0.0, static_cast<double>(end)));
  };
  for (std::size_t k = 0; k < polygons.size(); ++k) {
    const Projected& p = polygons[k];
    double low_v = 1e30, high_v = -1e30;
    for (const Point& q : p.outline) low_v = std::min(low_v, q.y()), high_v = std::max(high_v, q.y());
    const int rows = out.polygon.rows, columns = out.polygon.cols;
    for (int row = first_from(low_v, rows); row < first_from(high_v, rows); ++row) {
      const double v = to_pixel(row);
      double low = 0, high = 0;
      if (!Span(p.outline, v, low, high)) continue;
      const int begin = first_from(low, columns), end = first_from(high, columns);
      const float start = p.inverse_z.At(static_cast<float>(to_pixel(begin)), static_cast<float>(v));
      Cover(out.inverse_z[row] + begin, out.polygon[row] + begin, end - begin, start,
            p.inverse_z.u / static_cast<float>(per_pixel), static_cast<std::int32_t>(k));
    }
  }
  return out;
}

using Levels = std::vector<StreetTexture::Level>;

float Bilinear(const StreetTexture::Level& level, float x, float y) {
  x = std::clamp(x - 0.5f, 0.0f, static_cast<float>(level.width) - 1.001f);
  y = std::clamp(y - 0.5f, 0.0f, static_cast<float>(level.height) - 1.001f);
  const int column = static_cast<int>(x), row = static_cast<int>(y);
  const float wx = x - static_cast<float>(column), wy = y - static_cast<float>(row);
  const unsigned char* above = level.grey + row * level.width + column;
  const unsigned char* below = above + level.width;
  const float a = static_cast<float>(above[0]) + wx * static_cast<float>(above[1] - above[0]);
  const float b = static_cast<float>(below[0]) + wx * static_cast<float>(below[1] - below[0]);
  return a + wy * (b - a);
}

// Half the binary logarithm of x >= 1, to a few per cent.
float HalfLog2(float x) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &x, sizeof bits);
  const float exponent = static_cast<float>(static_cast<int>(bits >> 23) - 127);
  const float mantissa = static_cast<float>(bits & 0x7fffff) * 0x1p-23f;
  return 0.5f * (exponent + mantissa * (1.33f - 0.33f * mantissa));
}

float Trilinear(const Levels& levels, float s, float t, float lod) {
  const int last = static_cast<int>(levels.size()) - 1;
  const int fine = std::min(static_cast<int>(lod), last);
  const float scale = 1.0f / static_cast<float>(1 << fine);
  const float near = Bilinear(levels[static_cast<std::size_t>(fine)], s * scale, t * scale);
  const float weight = lod - static_cast<float>(fine);
  if (fine == last || weight < 0.02f) return near;
  const float far = Bilinear(levels[static_cast<std::size_t>(fine) + 1], s * scale / 2, t * scale / 2);
  return near + weight * (far - near);
}

float Shade(const Projected& p, const Levels& levels, float u, float v) {
  const float z = 1 / p.inverse_z.At(u, v);
  const float s = p.s.At(u, v) * z, t = p.t.At(u, v) * z;
  // How the texture moves from pixel to pixel.
  const float ds_u = (p.s.u - s * p.inverse_z.u) * z, dt_u = (p.t.u - t * p.inverse_z.u) * z;
  const float ds_v = (p.s.v - s * p.inverse_z.v) * z, dt_v = (p.t.v - t * p.inverse_z.v) * z;
  const float square_u = ds_u * ds_u + dt_u * dt_u, square_v = ds_v * ds_v + dt_v * dt_v;
  const bool along_u = square_u > square_v;
  const float longer = along_u ? square_u : square_v, shorter = along_u ? square_v : square_u;
  int taps = 1;
  while (taps < kMostTaps && longer > 2 && longer > 1.5f * static_cast<float>(taps * taps) * shorter) ++taps;
  const float square = longer / static_cast<float>(taps * taps);
  const float lod = square > 1 ? HalfLog2(square) : 0;
  if (taps == 1) return Trilinear(levels, s, t, lod);
  float sum = 0;
  for (int k = 0; k < taps; ++k) {
    const float at = (static_cast<float>(k) + 0.5f) / static_cast<float>(taps) - 0.5f;
    sum += Trilinear(levels, s + at * (along_u ? ds_u : ds_v), t + at * (along_u ? dt_u : dt_v), lod);
  }
  return sum / static_cast<float>(taps);
}

}  // namespace

cv::Mat1f RenderStreet(const StreetScene& scene, const StreetView& view, const SE3& T_world_camera) {
  const std::vector<Projected> polygons = Project(scene, view, T_world_camera);
  const Visibility visible = FindVisible(polygons, view, 2);
  std::vector<const Levels*> levels(polygons.size());  // only what is seen gets painted
  const auto shade = [&](std::int32_t id, float u, float v) {
    if (id == kNothing) return kHaze;
    const auto k = static_cast<std::size_t>(id);
    if (levels[k] == nullptr) levels[k] = &polygons[k].texture->Get();
    return Shade(polygons[k], *levels[k], u, v);
  };
  cv::Mat1f image(view.height, view.width);
  for (int row = 0; row < view.height; ++row) {
    const std::int32_t *above = visible.polygon[2 * row], *below = visible.polygon[2 * row + 1];
    const float v = static_cast<float>(row);
    for (int column = 0; column < view.width; ++column) {
      const std::int32_t a = above[2 * column], b = above[2 * column + 1], c = below[2 * column],
                         d = below[2 * column + 1];
      const float u = static_cast<float>(column);
      if (a == b && a == c && a == d) {
        image(row, column) = shade(a, u, v);
      } else {  // an edge
        image(row, column) = (shade(a, u - 0.25f, v - 0.25f) + shade(b, u + 0.25f, v - 0.25f) +
                              shade(c, u - 0.25f, v + 0.25f) + shade(d, u + 0.25f, v + 0.25f)) /
                             4;
      }
    }
  }
  return image;
}

cv::Mat1f RenderStreetDepth(const StreetScene& scene, const StreetView& view, const SE3& T_world_camera) {
  const Visibility visible = FindVisible(Project(scene, view, T_world_camera), view, 1);
  cv::Mat1f depth(view.height, view.width);
  for (int row = 0; row < view.height; ++row) {
    for (int column = 0; column < view.width; ++column) {
      depth(row, column) = visible.polygon(row, column) == kNothing ? 0 : 1 / visible.inverse_z(row, column);
    }
  }
  return depth;
}

}  // namespace terse
