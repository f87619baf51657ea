// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/register.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>
#include <numeric>

#include "core/base/elementary.h"
#include "core/base/parallel.h"
#include "core/base/ranges.h"
#include "core/measure/mass.h"
#include "core/register/overlap.h"
#include "core/register/rotations.h"

namespace spherule {

namespace {

constexpr std::size_t kRotations = 4608;
constexpr double kApartDegrees = 20;    // starts nearer to a better one are left out
constexpr double kSameDegrees = 8;      // ends nearer than this are one pose
constexpr double kNearlyAsGood = 0.05;  // share of the best one's agreement
constexpr double kPoorShare = 0.75;     // of either surface near the other

// Symmetric, with these eigenvalues raised to a power.
Mat3 power(const Mat3& symmetric, double exponent) {
  Eigen::Matrix3d e;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) e(i, j) = symmetric.rows[static_cast<std::size_t>(i)][j];
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(e);
  const Eigen::Vector3d values = solver.eigenvalues().cwiseMax(1e-9 * solver.eigenvalues()(2));
  const Eigen::Matrix3d p =
      solver.eigenvectors() * values.array().pow(exponent).matrix().asDiagonal() * solver.eigenvectors().transpose();
  Mat3 result;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result.rows[static_cast<std::size_t>(i)][j] = p(i, j);
  return result;
}

// From where a shape is to where shapes of one class differ by a rotation: about the origin, of volume 1 (rigid: of the
// common size), and for affine maps as wide in every direction.
AffineMap to_unit(const Shape& shape, TransformKind kind, double common_size) {
  Mat3 linear = scaled(1 / (kind == TransformKind::rigid ? common_size : shape.size_mm()), Mat3{});
  if (kind == TransformKind::affine) {
    const Mat3 white = power(shape.covariance, -0.5);
    linear = scaled(1 / (elementary::cbrt(determinant(white)) * shape.size_mm()), white);
  }
  return {linear, -(linear * shape.centroid)};
}

SoftBalls soft_balls(const Shape& shape, const AffineMap& unit) {
  SoftBalls balls;
  const double scale = scale_of(unit);
  for (std::size_t i = 0; i < shape.spheres.size(); ++i) {
    const double share = shape.masses[i] / shape.volume_mm3;
    if (!(share > 0)) continue;
    // The standard deviation of the ball of that volume along any axis is its radius over the root of 5.
    const double radius = scale * elementary::cbrt(3 * shape.masses[i] / (4 * std::numbers::pi));
    balls.push_back({unit(shape.spheres[i].centre), radius * 0.6, share});
  }
  return balls;
}

struct Candidate {
  AffineMap map;
  double score = 0;
};

double turn_between(const AffineMap& a, const AffineMap& b) {
  return angle_between(nearest_rotation(a.linear), nearest_rotation(b.linear));
}

// The best first, and none that another one makes superfluous or that numbers cannot undo.
std::vector<Candidate> distinct(std::vector<Candidate> candidates, double degrees, std::size_t most) {
  std::erase_if(candidates, [](const Candidate& c) {
    return !is_proper(c.map) || !is_proper(inverse(c.map)) || !std::isfinite(c.score);
  });
  std::ranges::stable_sort(candidates, std::greater<>(), &Candidate::score);
  std::vector<Candidate> kept;
  for (const Candidate& c : candidates) {
    if (kept.size() == most) break;
    if (std::ranges::none_of(kept, [&](const Candidate& k) { return turn_between(k.map, c.map) < degrees; }))
      kept.push_back(c);
  }
  return kept;
}

class Registering {
 public:
  Registering(const SphereModel& fixed, const SphereModel& moving, const RegistrationOptions& options,
              const Context& context)
      : fixed_model_(fixed), moving_model_(moving), options_(options), context_(context) {}

  Registration run() {
    timed("shapes", 0, [&] {
      std::array<Shape, 2> shapes;
      const Context quiet{.threads = 1, .cancel = context_.cancel, .progress = {}};
      parallel_for({.threads = context_.threads, .cancel = context_.cancel, .progress = {}}, {}, 2, 1,
                   [&](std::size_t i, std::size_t) {
                     shapes[i] = shape_of(i == 0 ? fixed_model_ : moving_model_, options_.k, 40'000, quiet);
                   });
      fixed_ = std::move(shapes[0]);
      moving_ = std::move(shapes[1]);
    });
    std::vector<Candidate> found;
    timed("search", 0.3, [&] { found = options_.method == RegistrationMethod::global ? by_overlap() : by_matching(); });
    require_some(found);
    for (Candidate& c : found) c.map = bounded(c.map);
    if (options_.refine) timed("surfaces", 0.5, [&] { found = by_surfaces(std::move(found)); });
    found = distinct(std::move(found), 0, options_.inits);
    require_some(found);
    timed("quality", 0.8, [&] { describe(found); });
    context_.report("register", 1);
    return std::move(result_);
  }

 private:
  template <typename Work>
  void timed(const char* stage, double progress, Work&& work) {
    context_.throw_if_cancelled();
    context_.report("register", progress);
    const auto begin = std::chrono::steady_clock::now();
    work();
    result_.timings.push_back({stage, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count()});
  }

  std::vector<Candidate> by_overlap() const {
    const double common = std::sqrt(fixed_.size_mm() * moving_.size_mm());
    const AffineMap fixed_unit = to_unit(fixed_, options_.transform, common);
    const AffineMap moving_unit = to_unit(moving_, options_.transform, common);
    const SoftBalls fixed = soft_balls(fixed_, fixed_unit), moving = soft_balls(moving_, moving_unit);
    const std::vector<Mat3> rotations = even_rotations(kRotations, options_.seed);
    const std::vector<float> values = overlaps(fixed, moving, rotations, silent());
    std::vector<std::uint32_t> order(rotations.size());
    std::iota(order.begin(), order.end(), 0U);
    std::ranges::stable_sort(order, std::greater<>(), [&](std::uint32_t i) { return values[i]; });
    std::vector<Mat3> starts;
    for (const std::uint32_t i : order) {
      if (starts.size() == options_.inits) break;
      if (std::ranges::none_of(starts, [&](const Mat3& s) { return angle_between(s, rotations[i]) < kApartDegrees; }))
        starts.push_back(rotations[i]);
    }
    std::vector<Candidate> ends(starts.size());
    const AffineMap from_unit = inverse(fixed_unit);
    parallel_for(silent(), {}, starts.size(), 1, [&](std::size_t i, std::size_t) {
      const Climbed top =
          climb(fixed, moving, {starts[i], 1, {}}, options_.transform != TransformKind::rigid, 30, silent());
      ends[i] = {composed(from_unit, composed(top.pose.map(), moving_unit)), top.value};
    });
    return distinct(std::move(ends), kSameDegrees, options_.inits);
  }

  std::vector<Candidate> by_matching() const {
    const double scale = options_.transform == TransformKind::rigid ? 1 : radius_ratio(fixed_, moving_);
    const auto posed = [&](const Mat3& turn) {
      const Mat3 linear = scaled(scale, turn);
      return AffineMap{linear, fixed_.centroid - linear * moving_.centroid};
    };
    std::vector<AffineMap> starts;
    MatchingWeights anywhere = options_.weights;
    anywhere.position = 0;
    const auto pairs = match_spheres(fixed_, moving_, posed({}), anywhere, context_);
    if (pairs.size() >= 3) starts.push_back(solve(options_.transform, point_pairs(fixed_, moving_, pairs)));
    for (const Mat3& turn : principal_turns()) starts.push_back(posed(turn));
    for (const Mat3& turn : even_rotations(options_.inits, options_.seed)) starts.push_back(posed(turn));
    std::vector<Candidate> ends(starts.size());
    parallel_for(silent(), {}, starts.size(), 1, [&](std::size_t i, std::size_t) {
      ends[i].map = match_from(fixed_, moving_, starts[i], options_.transform, options_.weights, 30, silent());
      ends[i].score = surface_agreement(fixed_.surface, moving_.surface, ends[i].map, 500, reach(ends[i].map));
    });
    return distinct(std::move(ends), kSameDegrees, options_.inits);
  }

  // With the nearest allowed scale, about the moving centroid.
  AffineMap bounded(const AffineMap& map) const {
    const double scale = scale_of(map);
    if (options_.transform == TransformKind::rigid) return map;
    const double factor = std::clamp(scale, options_.min_scale, options_.max_scale) / scale;
    if (factor == 1) return map;
    const Mat3 linear = scaled(factor, map.linear);
    return {linear, map(moving_.centroid) - linear * moving_.centroid};
  }

  // The rotations that lay the principal axes of one shape on those of the other.
  std::vector<Mat3> principal_turns() const {
    const auto axes = [](const Shape& shape) {
      Moments moments{.volume = 1, .first = {}, .second = shape.covariance};
      return mass_properties(moments).principal_axes;
    };
    const Mat3 f = axes(fixed_), m = axes(moving_);
    std::vector<Mat3> turns;
    for (const Vec3 sign : {Vec3{1, 1, 1}, Vec3{1, -1, -1}, Vec3{-1, 1, -1}, Vec3{-1, -1, 1}}) {
      const Mat3 signs{{Vec3{sign.x, 0, 0}, Vec3{0, sign.y, 0}, Vec3{0, 0, sign.z}}};
      turns.push_back(transposed(f) * signs * m);
    }
    return turns;
  }

  // In rounds: few points tell the hopeless from the good, and what is left gets more of them.
  std::vector<Candidate> by_surfaces(std::vector<Candidate> candidates) const {
    struct Round {
      std::size_t samples;  // of each surface, in all candidates together
      std::size_t least, most;
      int iterations;
      double settled, reach;
      double keep;  // share of the best one's agreement
    };
    for (const Round& round :
         {Round{4'000, 100, 400, 6, 0.03, 0.25, 0.5}, Round{8'000, 400, 400, 15, 0.03, 0.1, 1 - 2 * kNearlyAsGood},
          Round{12'000, 500, 12'000, 25, 0.003, 0.05, 0}}) {
      const std::size_t samples = std::clamp(round.samples / candidates.size(), round.least, round.most);
      const SurfaceFitOptions options{.kind = options_.transform,
                                      .samples = samples,
                                      .iterations = round.iterations,
                                      .settled = round.settled,
                                      .reach_mm = round.reach * fixed_.size_mm(),
                                      .centre = fixed_.centroid,
                                      .size_mm = fixed_.size_mm(),
                                      .min_scale = options_.min_scale,
                                      .max_scale = options_.max_scale};
      // The threads share one candidate, or the candidates.
      const bool few = candidates.size() < context_.threads;
      const Context alone{.threads = 1, .cancel = context_.cancel, .progress = {}};
      parallel_for(few ? alone : silent(), {}, candidates.size(), 1, [&](std::size_t i, std::size_t) {
        Candidate& c = candidates[i];
        c.map = fit_surfaces(fixed_.surface, moving_.surface, c.map, options, few ? silent() : alone);
        c.score = surface_agreement(fixed_.surface, moving_.surface, c.map, 2 * samples, reach(c.map));
      });
      candidates = distinct(std::move(candidates), kSameDegrees, options_.inits);
      if (candidates.empty()) break;
      std::erase_if(candidates, [&](const Candidate& c) { return c.score < round.keep * candidates[0].score; });
    }
    return candidates;
  }

  SurfaceDistance surfaces(const AffineMap& map, std::size_t samples) const {
    return surface_distance(fixed_.surface, moving_.surface, map, samples, reach(map));
  }
  double reach(const AffineMap& map) const {
    return std::max({0.02 * fixed_.size_mm(), fixed_.surface.spacing_mm, scale_of(map) * moving_.surface.spacing_mm});
  }

  // Models that differ by many orders of magnitude, or flat ones under affine maps, may have no map that numbers can
  // tell.
  static void require_some(const std::vector<Candidate>& found) {
    if (!found.empty()) return;
    throw Error(ErrorCode::unusable,
                "The models differ too much in size, or are too flat, to be laid on each other; give both in the same "
                "unit, or choose another kind of transform.");
  }

  void describe(std::vector<Candidate>& found) {
    const AffineMap& map = found[0].map;
    result_.moving_to_fixed = map;
    result_.centre = moving_.centroid;
    result_.reach_mm = reach(map);
    constexpr std::size_t kSamples = 10'000;
    result_.surfaces = surface_distance(fixed_.surface, moving_.surface, map, kSamples, reach(map), silent());
    const bool few = !fixed_model_.solid && !moving_model_.solid &&
                     fixed_model_.spheres.size() + moving_model_.spheres.size() <= 20'000;
    result_.overlap = few && options_.transform != TransformKind::affine
                          ? exact_overlap(fixed_model_.spheres, moving_model_.spheres, map, silent())
                          : sampled_overlap(fixed_model_, moving_model_, map, overlap_samples, silent());
    result_.spheres_overlap = exact_overlap(fixed_.spheres, moving_.spheres, map, silent());
    result_.pairs = match_spheres(fixed_, moving_, map, options_.weights, context_);
    const auto points = point_pairs(fixed_, moving_, result_.pairs);
    result_.residual_rms_mm = rms_residual(map, points);
    for (const SpherePair& p : result_.pairs) {
      result_.matched_share +=
          0.5 * (fixed_.masses[p.fixed] / fixed_.volume_mm3 + moving_.masses[p.moving] / moving_.volume_mm3);
    }
    result_.radius_ratio = radius_ratio(fixed_, moving_);
    result_.poor = std::min(result_.surfaces.fixed_within, result_.surfaces.moving_within) < kPoorShare;
    // Of poor matches all are about as poor.
    for (std::size_t i = 1; i < found.size() && !result_.poor; ++i) {
      if (found[i].score < (1 - kNearlyAsGood) * found[0].score) break;
      result_.others.push_back({found[i].map, surfaces(found[i].map, 3000)});
    }
    result_.fixed_spheres = std::move(fixed_.spheres);
    result_.moving_spheres = std::move(moving_.spheres);
    warn();
  }

  void warn() {
    auto& warnings = result_.warnings;
    if (result_.overlap.iou == 0) {
      warnings.emplace_back("The models do not overlap at the pose found; check the scale's bounds.");
    }
    if (result_.poor) {
      warnings.emplace_back(
          "The surfaces agree poorly even at the best pose found: the models may be of different objects.");
    }
    if (!result_.others.empty()) {
      warnings.emplace_back("Other poses are nearly as good: the object may be symmetric, and any of them right.");
    }
    const double scale = scale_of(result_.moving_to_fixed);
    if (options_.transform != TransformKind::rigid &&
        (scale < options_.min_scale * 1.01 || scale > options_.max_scale / 1.01)) {
      warnings.emplace_back("The scale is at its bound: with wider bounds another pose may fit better.");
    }
  }

  Context silent() const { return {.threads = context_.threads, .cancel = context_.cancel, .progress = {}}; }

  const SphereModel &fixed_model_, &moving_model_;
  const RegistrationOptions& options_;
  const Context& context_;
  Shape fixed_, moving_;
  Registration result_;
};

void require(bool holds, const std::string& field, const std::string& sentence) {
  if (!holds) throw Error(ErrorCode::invalid_argument, sentence, {{"/" + field, sentence}});
}

}  // namespace

void check_registration_options(const RegistrationOptions& o) {
  const auto& k = ranges::registered_spheres;
  require(k.holds(o.k), "k", "Give k as a whole number " + k.words() + ".");
  require(ranges::inits.holds(o.inits), "inits", "Give inits as a whole number " + ranges::inits.words() + ".");
  require(ranges::scale.holds(o.min_scale) && ranges::scale.holds(o.max_scale) && o.min_scale <= o.max_scale,
          "scale_bounds", "Give scale_bounds as two numbers " + ranges::scale.words() + ", the lower one first.");
  for (const double w : {o.weights.position, o.weights.size, o.weights.shape, o.weights.alone})
    require(ranges::weight.holds(w), "weights", "Give weights as numbers " + ranges::weight.words() + ".");
}

Registration register_models(const SphereModel& fixed, const SphereModel& moving, const RegistrationOptions& options,
                             const Context& context) {
  check_registration_options(options);
  return Registering(fixed, moving, options, context).run();
}

}  // namespace spherule
