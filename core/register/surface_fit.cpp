// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/surface_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "core/base/parallel.h"

namespace spherule {

namespace {

// Where a point of one surface meets the other, in the fixed frame.
struct Contact {
  Vec3 at;         // the moving point, posed
  Vec3 normal;     // of the fixed surface
  double off = 0;  // along the normal, from the moving point to the fixed surface
  double distance_squared = 0;
  double agreement = 0;  // cosine between the normals
};

double biweight(double squared, double reach) {
  const double t = 1 - squared / (reach * reach);
  return t > 0 ? t * t : 0;
}

// Of every step-th point of both surfaces, first the moving ones.
class Contacts {
 public:
  Contacts(const Surface& fixed, const Surface& moving, std::size_t samples)
      : fixed_(fixed),
        moving_(moving),
        fixed_step_(std::max<std::size_t>(fixed.size() / samples, 1)),
        moving_step_(std::max<std::size_t>(moving.size() / samples, 1)) {}

  std::size_t from_moving() const { return (moving_.size() + moving_step_ - 1) / moving_step_; }
  std::size_t size() const { return from_moving() + (fixed_.size() + fixed_step_ - 1) / fixed_step_; }

  // Contact number i; far ones may come back as none.
  bool find(std::size_t i, const AffineMap& map, const AffineMap& back, const Mat3& cotangent, double reach,
            Contact& contact) const {
    std::size_t f = 0, m = 0;
    if (i < from_moving()) {
      m = i * moving_step_;
      contact.at = map(moving_.points[m]);
      const auto near = fixed_.tree.nearest(contact.at, reach * reach);
      if (near.index == detail::PointTree::none) return false;
      f = near.index;
    } else {
      f = (i - from_moving()) * fixed_step_;
      const double there = reach / scale_of(map) * 1.5;
      const auto near = moving_.tree.nearest(back(fixed_.points[f]), there * there);
      if (near.index == detail::PointTree::none) return false;
      m = near.index;
      contact.at = map(moving_.points[m]);
    }
    const Vec3 gap = fixed_.points[f] - contact.at;
    const Vec3 turned = normalised(cotangent * moving_.normals[m]), both = fixed_.normals[f] + turned;
    contact.agreement = dot(fixed_.normals[f], turned);
    contact.normal = contact.agreement > -0.9 ? normalised(both) : fixed_.normals[f];
    contact.off = dot(contact.normal, gap);
    contact.distance_squared = squared_norm(gap);
    return contact.distance_squared < reach * reach;
  }

 private:
  const Surface &fixed_, &moving_;
  std::size_t fixed_step_, moving_step_;
};

// The linear map that turns normals along with surfaces.
Mat3 cotangent_of(const AffineMap& map) { return transposed(inverse(map.linear)); }

double median_of(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

using Matrix = Eigen::Matrix<double, 12, 12>;
using Vector = Eigen::Matrix<double, 12, 1>;

// How the distance along the normal changes with the step's parameters: turns, shifts, growth; or the nine elements of
// the linear map, and shifts.
int derivative(TransformKind kind, Vec3 x, Vec3 n, Vector& row) {
  const Vec3 turn = cross(x, n);
  switch (kind) {
    case TransformKind::rigid: row.head<6>() << turn.x, turn.y, turn.z, n.x, n.y, n.z; return 6;
    case TransformKind::similarity: row.head<7>() << turn.x, turn.y, turn.z, n.x, n.y, n.z, dot(x, n); return 7;
    case TransformKind::affine: break;
  }
  row << n.x * x.x, n.x * x.y, n.x * x.z, n.y * x.x, n.y * x.y, n.y * x.z, n.z * x.x, n.z * x.y, n.z * x.z, n.x, n.y,
      n.z;
  return 12;
}

AffineMap step_map(TransformKind kind, const Vector& by) {
  if (kind == TransformKind::affine) {
    return {{{Vec3{1 + by(0), by(1), by(2)}, Vec3{by(3), 1 + by(4), by(5)}, Vec3{by(6), by(7), 1 + by(8)}}},
            {by(9), by(10), by(11)}};
  }
  const double growth = kind == TransformKind::similarity ? std::exp(std::clamp(by(6), -0.1, 0.1)) : 1;
  return {scaled(growth, rotation(Vec3{by(0), by(1), by(2)})), {by(3), by(4), by(5)}};
}

}  // namespace

AffineMap fit_surfaces(const Surface& fixed, const Surface& moving, const AffineMap& start,
                       const SurfaceFitOptions& options) {
  const Contacts contacts(fixed, moving, options.samples);
  AffineMap map = start;
  const double scale = scale_of(start);
  const double spacing = std::max(fixed.spacing_mm, scale * moving.spacing_mm);
  const double least = 2 * spacing;
  double reach = std::max(options.reach_mm, least);
  // Lengths in units of the size, from the centre.
  const AffineMap to_unit{scaled(1 / options.size_mm, Mat3{}), -((1 / options.size_mm) * options.centre)};
  const AffineMap from_unit = inverse(to_unit);
  std::vector<double> distances;
  std::vector<Contact> found;
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    const AffineMap back = inverse(map);
    const Mat3 cotangent = cotangent_of(map);
    found.clear();
    distances.clear();
    for (std::size_t i = 0; i < contacts.size(); ++i) {
      Contact contact;
      if (!contacts.find(i, map, back, cotangent, reach, contact)) continue;
      distances.push_back(contact.distance_squared);
      if (contact.agreement > 0) found.push_back(contact);
    }
    if (found.size() < 12) return map;
    const double now = std::clamp(3 * std::sqrt(median_of(distances)), least, reach);
    Matrix normal = Matrix::Zero();
    Vector right = Vector::Zero();
    int n = 0;
    for (const Contact& contact : found) {
      const double weight = contact.agreement * biweight(contact.distance_squared, now);
      if (weight == 0) continue;
      Vector row = Vector::Zero();
      n = derivative(options.kind, to_unit(contact.at), contact.normal, row);
      normal.selfadjointView<Eigen::Lower>().rankUpdate(row, weight);
      right += (weight * contact.off / options.size_mm) * row;
    }
    if (n == 0) return map;
    // What the surfaces leave open (turns of a ball) stays as it is.
    const double damp = 1e-6 * normal.trace();
    for (int i = 0; i < 12; ++i) normal(i, i) += damp;
    Vector by = normal.selfadjointView<Eigen::Lower>().ldlt().solve(right);
    if (!by.allFinite()) return map;
    const double largest = by.cwiseAbs().maxCoeff();
    if (largest > 0.3) by *= 0.3 / largest;
    const AffineMap unit_step = step_map(options.kind, by);
    const AffineMap next = composed(from_unit, composed(unit_step, composed(to_unit, map)));
    const double grown = scale_of(next);
    if (!(determinant(next.linear) > 0) || grown < options.min_scale || grown > options.max_scale) return map;
    map = next;
    const bool settled = by.cwiseAbs().maxCoeff() * options.size_mm < options.settled * spacing;
    if (settled && reach <= now) break;
    reach = now;
  }
  return map;
}

SurfaceDistance surface_distance(const Surface& fixed, const Surface& moving, const AffineMap& map, std::size_t samples,
                                 double reach_mm, const Context& context) {
  const Contacts contacts(fixed, moving, samples);
  const AffineMap back = inverse(map);
  const Mat3 cotangent = cotangent_of(map);
  const double spacing = std::max(fixed.spacing_mm, scale_of(map) * moving.spacing_mm);
  std::vector<double> distances(contacts.size()), agreements(contacts.size(), 0.0);
  parallel_for(context, {}, contacts.size(), 512, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Contact contact;
      contacts.find(i, map, back, cotangent, 1e30, contact);
      const double beside = std::sqrt(std::max(contact.distance_squared - contact.off * contact.off, 0.0));
      distances[i] = std::hypot(contact.off, std::max(beside - spacing, 0.0));
      agreements[i] = std::max(contact.agreement, 0.0) * biweight(distances[i] * distances[i], reach_mm);
    }
  });
  SurfaceDistance result;
  const auto count = static_cast<double>(contacts.size());
  for (std::size_t i = 0; i < distances.size(); ++i) {
    result.mean_mm += distances[i] / count;
    result.agreement += agreements[i] / count;
    if (distances[i] < reach_mm) (i < contacts.from_moving() ? result.moving_within : result.fixed_within) += 1;
  }
  result.moving_within /= static_cast<double>(contacts.from_moving());
  result.fixed_within /= count - static_cast<double>(contacts.from_moving());
  const auto at = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() * 95 / 100);
  std::nth_element(distances.begin(), at, distances.end());
  result.p95_mm = *at;
  return result;
}

}  // namespace spherule
