// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/surface_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/base/elementary.h"
#include "core/base/parallel.h"

namespace spherule {

namespace {

// Where a point of one surface meets the other, in the fixed frame.
struct Contact {
  std::uint32_t partner = detail::PointTree::none;  // index of the other surface's point
  bool near = false;                                // within reach; else nothing below holds
  Vec3 at;                                          // the moving point, posed
  Vec3 normal;                                      // mean of both surfaces'
  double off = 0;                                   // along the normal, from the moving point to the fixed surface
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

  // Brings contact number i up to date. Where it was before bounds the search: between iterations little moves.
  void find(std::size_t i, const AffineMap& map, const AffineMap& back, const Mat3& cotangent, double reach,
            Contact& contact) const {
    const bool forth = i < from_moving();
    const Surface& other = forth ? fixed_ : moving_;
    const std::size_t own = forth ? i * moving_step_ : (i - from_moving()) * fixed_step_;
    const Vec3 p = forth ? map(moving_.points[own]) : back(fixed_.points[own]);
    const double there = forth ? reach : reach / scale_of(map) * 1.5;
    double within = there * there;
    contact.near =
        contact.partner != detail::PointTree::none && squared_norm(other.points[contact.partner] - p) < within;
    if (contact.near) within = squared_norm(other.points[contact.partner] - p);
    if (const auto nearest = other.tree.nearest(p, within); nearest.index != detail::PointTree::none) {
      contact.partner = nearest.index;
      contact.near = true;
    }
    if (!contact.near) return;
    const std::size_t f = forth ? contact.partner : own, m = forth ? own : contact.partner;
    contact.at = forth ? p : map(moving_.points[m]);
    const Vec3 gap = fixed_.points[f] - contact.at;
    const Vec3 turned = normalised(cotangent * moving_.normals[m]), both = fixed_.normals[f] + turned;
    contact.agreement = dot(fixed_.normals[f], turned);
    contact.normal = contact.agreement > -0.9 ? normalised(both) : fixed_.normals[f];
    contact.off = dot(contact.normal, gap);
    contact.distance_squared = squared_norm(gap);
    contact.near = contact.distance_squared < reach * reach;
  }

 private:
  const Surface &fixed_, &moving_;
  std::size_t fixed_step_, moving_step_;
};

// The linear map that turns normals along with surfaces.
Mat3 cotangent_of(const AffineMap& map) { return transposed(inverse(map.linear)); }

double spacing_under(const Surface& fixed, const Surface& moving, const AffineMap& map) {
  return std::max(fixed.spacing_mm, scale_of(map) * moving.spacing_mm);
}

// What lies along the surface within the spacing is no distance: the nearest point need not be opposite.
double distance_of(const Contact& contact, double spacing) {
  const double beside = std::sqrt(std::max(contact.distance_squared - contact.off * contact.off, 0.0));
  return elementary::hypot(contact.off, std::max(beside - spacing, 0.0));
}

double agreement_of(const Contact& contact, double distance, double reach) {
  return std::max(contact.agreement, 0.0) * biweight(distance * distance, reach);
}

double median_of(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

constexpr int kMost = 12;
using Matrix = Eigen::Matrix<double, kMost, kMost>;
using Vector = Eigen::Matrix<double, kMost, 1>;

int parameters(TransformKind kind) {
  return kind == TransformKind::rigid ? 6 : kind == TransformKind::similarity ? 7 : 12;
}

// How the distance along the normal changes with the step's parameters: turns, shifts, growth; or the nine elements of
// the linear map, and shifts.
std::array<double, kMost> derivative(TransformKind kind, Vec3 x, Vec3 n) {
  if (kind == TransformKind::affine) {
    return {n.x * x.x, n.x * x.y, n.x * x.z, n.y * x.x, n.y * x.y, n.y * x.z,
            n.z * x.x, n.z * x.y, n.z * x.z, n.x,       n.y,       n.z};
  }
  const Vec3 turn = cross(x, n);
  return {turn.x, turn.y, turn.z, n.x, n.y, n.z, dot(x, n)};
}

AffineMap step_map(TransformKind kind, const Vector& by) {
  if (kind == TransformKind::affine) {
    return {{{Vec3{1 + by(0), by(1), by(2)}, Vec3{by(3), 1 + by(4), by(5)}, Vec3{by(6), by(7), 1 + by(8)}}},
            {by(9), by(10), by(11)}};
  }
  const double growth = kind == TransformKind::similarity ? elementary::exp(std::clamp(by(6), -0.1, 0.1)) : 1;
  return {scaled(growth, rotation(Vec3{by(0), by(1), by(2)})), {by(3), by(4), by(5)}};
}

}  // namespace

AffineMap fit_surfaces(const Surface& fixed, const Surface& moving, const AffineMap& start,
                       const SurfaceFitOptions& options, const Context& context) {
  const Contacts pairs(fixed, moving, options.samples);
  AffineMap map = start;
  const double spacing = spacing_under(fixed, moving, start);
  const double least = 2 * spacing;
  double reach = std::max(options.reach_mm, least);
  // Lengths in units of the size, from the centre.
  const AffineMap to_unit{scaled(1 / options.size_mm, Mat3{}), -((1 / options.size_mm) * options.centre)};
  const AffineMap from_unit = inverse(to_unit);
  const int n = parameters(options.kind);
  std::vector<Contact> contacts(pairs.size());
  std::vector<double> distances;
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    const AffineMap back = inverse(map);
    const Mat3 cotangent = cotangent_of(map);
    parallel_for(context, {}, contacts.size(), 1024, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) pairs.find(i, map, back, cotangent, reach, contacts[i]);
    });
    distances.clear();
    std::size_t agreeing = 0;
    for (const Contact& contact : contacts) {
      if (!contact.near) continue;
      distances.push_back(contact.distance_squared);
      agreeing += contact.agreement > 0;
    }
    if (agreeing < 12) return map;
    const double now = std::clamp(3 * std::sqrt(median_of(distances)), least, reach);
    Matrix normal = Matrix::Zero();
    Vector right = Vector::Zero();
    for (const Contact& contact : contacts) {
      if (!contact.near || contact.agreement <= 0) continue;
      const double weight = contact.agreement * biweight(contact.distance_squared, now);
      if (weight == 0) continue;
      const std::array<double, kMost> row = derivative(options.kind, to_unit(contact.at), contact.normal);
      const double off = contact.off / options.size_mm;
      for (int i = 0; i < n; ++i) {
        const double weighted = weight * row[static_cast<std::size_t>(i)];
        for (int j = 0; j <= i; ++j) normal(i, j) += weighted * row[static_cast<std::size_t>(j)];
        right(i) += weighted * off;
      }
    }
    // What the surfaces leave open (turns of a ball) stays as it is.
    const double damp = 1e-6 * normal.trace();
    if (damp == 0) return map;
    for (int i = 0; i < kMost; ++i) normal(i, i) += damp;
    Vector by = normal.selfadjointView<Eigen::Lower>().ldlt().solve(right);
    if (!by.allFinite()) return map;
    const double largest = by.cwiseAbs().maxCoeff();
    if (largest > 0.3) by *= 0.3 / largest;
    const AffineMap unit_step = step_map(options.kind, by);
    const AffineMap next = composed(from_unit, composed(unit_step, composed(to_unit, map)));
    const double grown = scale_of(next);
    if (!is_proper(next) || grown < options.min_scale || grown > options.max_scale) return map;
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
  const double spacing = spacing_under(fixed, moving, map);
  std::vector<double> distances(contacts.size()), agreements(contacts.size(), 0.0);
  parallel_for(context, {}, contacts.size(), 512, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Contact contact;
      contacts.find(i, map, back, cotangent, 1e30, contact);
      distances[i] = distance_of(contact, spacing);
      agreements[i] = agreement_of(contact, distances[i], reach_mm);
    }
  });
  SurfaceDistance result;
  const auto count = static_cast<double>(contacts.size());
  for (std::size_t i = 0; i < distances.size(); ++i) {
    result.mean_mm += distances[i];
    result.agreement += agreements[i];
    if (distances[i] < reach_mm) (i < contacts.from_moving() ? result.moving_within : result.fixed_within) += 1;
  }
  result.mean_mm /= count;
  result.agreement /= count;
  result.moving_within /= static_cast<double>(contacts.from_moving());
  result.fixed_within /= count - static_cast<double>(contacts.from_moving());
  const auto at = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() * 95 / 100);
  std::nth_element(distances.begin(), at, distances.end());
  result.p95_mm = *at;
  return result;
}

double surface_agreement(const Surface& fixed, const Surface& moving, const AffineMap& map, std::size_t samples,
                         double reach_mm) {
  const Contacts contacts(fixed, moving, samples);
  const AffineMap back = inverse(map);
  const Mat3 cotangent = cotangent_of(map);
  const double spacing = spacing_under(fixed, moving, map);
  double sum = 0;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    Contact contact;
    contacts.find(i, map, back, cotangent, reach_mm + spacing, contact);
    if (contact.near) sum += agreement_of(contact, distance_of(contact, spacing), reach_mm);
  }
  return sum / static_cast<double>(contacts.size());
}

}  // namespace spherule
