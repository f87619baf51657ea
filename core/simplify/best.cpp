// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/best.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <string>

#include "core/base/check.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/measure/enclosing.h"
#include "core/measure/union.h"
#include "core/simplify/cover.h"
#include "core/simplify/fit.h"
#include "core/simplify/levels.h"
#include "core/simplify/splitting.h"
#include "core/simplify/together.h"
#include "core/trees/ball_tree.h"

namespace spherule {

namespace {

constexpr double kFewestSamples = 200'000, kSamplesPerSphere = 1000;
constexpr std::uint32_t kMost = 65535;        // what Fit counts
constexpr std::uint32_t kMostToReach = 4096;  // spheres tried for an overlap
constexpr double kCalibrationCost = 0.005;    // of overlap
constexpr std::uint32_t kFewClusters = 16;    // that refinement starts from too,
constexpr std::uint32_t kManyClusters = 256;  // of small objects
constexpr std::uint64_t kSmall = 100'000;     // samples
constexpr double kLeastGain = 1e-4;           // of the samples, for which steps stay as they are
constexpr std::size_t kGrain = 1 << 12;

using Balls = std::vector<Sphere>;

Sphere to_patient(const Grid& grid, const Sphere& ball) { return {grid.to_patient(ball.centre), ball.radius}; }

// A coarser grid of nearly cubic voxels with about `wanted` inside samples, where the object has many more.
SampledObject working_copy(const SampledObject& object, double fewest, std::size_t k, const Context& context) {
  const double wanted = std::max(fewest, kSamplesPerSphere * static_cast<double>(k));
  std::array<std::int32_t, 3> steps{1, 1, 1};
  const auto inside = static_cast<double>(object.inside.count());
  while (inside / (double(steps[0]) * steps[1] * steps[2]) > 1.5 * wanted) {
    std::size_t finest = 0;
    for (std::size_t a = 1; a < 3; ++a) {
      if (steps[a] * object.grid.spacing[static_cast<int>(a)] <
          steps[finest] * object.grid.spacing[static_cast<int>(finest)])
        finest = a;
    }
    ++steps[finest];
  }
  return subsampled(object, steps, context);
}

// Balls over one object's samples, made better one at a time. Everything in the grid's frame.
class Refinement {
 public:
  Refinement(const SampledObject& object, Balls balls, const Context& context)
      : context_(context),
        fit_(object, context),
        balls_(std::move(balls)),
        samples_(static_cast<double>(object.inside.count())) {
    for (const Sphere& ball : balls_) context_.throw_if_cancelled(), fit_.add(ball);
  }

  const Balls& balls() const { return balls_; }

  // Every ball in turn, with steps that shrink from half a voxel to `finest` voxels as sweeps gain little. A ball that
  // could not move waits until one that overlaps it did.
  void sweep(int most, double finest) {
    double step = 0.5 * fit_.voxel();
    std::vector<std::uint8_t> settled(balls_.size(), 0);
    for (int s = 0; s < most && step >= finest * fit_.voxel(); ++s) {
      std::int64_t gained = 0;
      // In one sweep no ball's surface moves by more than the root of 3 steps along the axes and one of the radius.
      const double slack = 3 * step;
      Balls start = balls_;
      for (Sphere& ball : start) ball.radius += slack;
      const detail::BallTree near(start, context_);
      for (std::size_t i = 0; i < balls_.size(); ++i) {
        if (settled[i]) continue;
        context_.throw_if_cancelled();
        Sphere ball = balls_[i];
        fit_.remove(ball);
        const std::int64_t before = fit_.gain(ball);
        const std::int64_t after = compass(ball, step, before);
        fit_.add(ball);
        settled[i] = after == before;
        if (after == before) continue;
        gained += after - before;
        near.any_overlapping({ball.centre, ball.radius + slack}, [&](std::uint32_t j) {
          if (j != i && (detail::overlap(balls_[j], ball) || detail::overlap(balls_[j], balls_[i]))) settled[j] = 0;
          return false;
        });
        balls_[i] = ball;
      }
      if (static_cast<double>(gained) < kLeastGain * samples_) {
        step *= 0.5;
        std::ranges::fill(settled, 0);
      }
    }
  }

  // Moves balls that are worth least to the candidates that add most, as long as that gains. Whether any moved.
  bool relocate(std::span<const Sphere> candidates) {
    std::vector<std::pair<std::int64_t, std::size_t>> worth;
    for (std::size_t i = 0; i < balls_.size(); ++i) {
      context_.throw_if_cancelled();
      fit_.remove(balls_[i]);
      worth.emplace_back(fit_.gain(balls_[i]), i);
      fit_.add(balls_[i]);
    }
    std::ranges::sort(worth);
    std::vector<std::pair<std::int64_t, std::size_t>> heap;  // gain when last looked at, candidate from the back
    for (std::size_t c = 0; c < candidates.size(); ++c) {
      context_.throw_if_cancelled();
      heap.emplace_back(fit_.gain(candidates[c]), candidates.size() - c);
    }
    std::make_heap(heap.begin(), heap.end());
    std::size_t moved = 0;
    for (; moved <= balls_.size() / 4; ++moved) {
      const std::size_t i = worth[moved].second;
      Sphere ball = candidates[candidates.size() - best_of(candidates, heap)];
      const std::int64_t gain = improve(ball, fit_.gain(ball));
      fit_.add(ball);
      fit_.remove(balls_[i]);
      if (gain <= fit_.gain(balls_[i])) {
        fit_.add(balls_[i]);
        fit_.remove(ball);
        break;
      }
      balls_[i] = ball;
    }
    return moved > 0;
  }

 private:
  // The candidate of the largest gain now, approximately: gains fall as balls are added, but rise where one left.
  std::size_t best_of(std::span<const Sphere> candidates,
                      std::vector<std::pair<std::int64_t, std::size_t>>& heap) const {
    for (;;) {
      context_.throw_if_cancelled();
      std::pop_heap(heap.begin(), heap.end());
      const auto at = heap.back().second;
      heap.back().first = fit_.gain(candidates[candidates.size() - at]);
      std::push_heap(heap.begin(), heap.end());
      if (heap.front().second == at) return at;
    }
  }

  // Coarse steps while they gain. Returns the gain of what `ball` has become, from the one it has.
  std::int64_t improve(Sphere& ball, std::int64_t now) const {
    for (double step = std::max(0.1 * ball.radius, fit_.voxel()); step >= 0.5 * fit_.voxel(); step *= 0.5) {
      for (std::int64_t before = now - 1; before < now;) {
        before = now;
        now = compass(ball, step, now);
      }
    }
    return now;
  }
  // Steps along the axes and of the radius, likewise.
  std::int64_t compass(Sphere& ball, double step, std::int64_t now) const {
    for (int axis = 0; axis < 4; ++axis) {
      for (const double by : {step, -step}) {
        Sphere moved = ball;
        if (axis < 3) moved.centre[axis] += by;
        if (axis == 3) moved.radius = std::max(moved.radius + by, 0.1 * step);
        if (take_better(moved, ball, now)) break;
      }
    }
    return now;
  }
  bool take_better(const Sphere& moved, Sphere& ball, std::int64_t& now) const {
    context_.throw_if_cancelled();
    const std::int64_t gain = fit_.gain(moved);
    if (gain <= now) return false;
    now = gain;
    ball = moved;
    return true;
  }

  const Context& context_;
  detail::Fit fit_;
  Balls balls_;
  double samples_;
};

// All radii changed alike so that the exact volume of the union is `wanted_mm3`: Newton's method, for the derivative of
// the volume is the area. Nothing where it does not converge.
std::optional<Balls> calibrated(Balls balls, double wanted_mm3, const Context& context) {
  for (int step = 0; step < 20; ++step) {
    const UnionMeasures measures = measure_union(balls, context);
    const double missing = wanted_mm3 - measures.moments.volume;
    if (std::abs(missing) <= 1e-9 * wanted_mm3) return balls;
    if (!(measures.area_mm2 > 0)) return std::nullopt;
    for (Sphere& ball : balls) ball.radius = std::max(ball.radius + missing / measures.area_mm2, 0.0);
  }
  return std::nullopt;
}

class Best {
 public:
  Best(const SphereModel& model, const SampledObject& object, const BestOptions& options, const Context& context)
      : model_(model),
        object_(object),
        options_(options),
        context_(context),
        quiet_{.threads = context.threads, .cancel = context.cancel, .progress = {}} {}

  BestSpheres run() {
    const std::uint32_t wanted =
        options_.k.value_or(std::min<std::uint32_t>(kMostToReach, static_cast<std::uint32_t>(model_.spheres.size())));
    context_.report("best", 0);
    working_ = working_copy(object_, kFewestSamples, wanted, context_);
    const bool inner = options_.mode == BestOptions::Mode::inner;
    candidates_ = detail::thinned(detail::poles(model_, context_), wanted, context_);
    if (inner) {
      for (Sphere& c : candidates_) c = cut_to_object(c, object_, context_);
    }
    if (inner) working_ = object_;
    cover_ = detail::greedy_cover(candidates_, working_, wanted, quiet_);
    if (cover_.order.size() < wanted && working_.grid.dims != object_.grid.dims) {
      working_ = object_;
      cover_ = detail::greedy_cover(candidates_, working_, wanted, quiet_);
    }
    if (cover_.order.empty()) {
      throw Error(ErrorCode::unusable, "The model's spheres hold no sample of the object; choose a finer volume.");
    }
    for (Sphere& c : candidates_) local_.push_back(detail::to_grid(object_.grid, c));
    context_.report("best", 0.2);
    BestSpheres best;
    if (inner) {
      best.simplification = in_order();
      const auto covered = static_cast<double>(cover_.covered[best.simplification.last_level() - 1]);
      if (options_.k) best.optimality_gap = 1 - covered / static_cast<double>(cover_.bound);
    } else {
      const auto few = std::min({object_.inside.count() <= kSmall ? kManyClusters : kFewClusters, wanted,
                                 static_cast<std::uint32_t>(cover_.order.size())});
      clusters_ = split_spheres(
          model_, {.at = SplittingOptions::At::average, .k = few, .representative = Representative::volume}, quiet_);
      refine();
      best.simplification = in_levels();
    }
    add_members(best.simplification);
    context_.report("best", 1);
    return best;
  }

 private:
  Sphere pick(std::size_t i) const { return candidates_[cover_.order[i]]; }

  [[noreturn]] void refuse_overlap(double reached, std::size_t count) const {
    throw Error(ErrorCode::unusable, "That overlap is not reached: " + std::to_string(count) + " spheres reach " +
                                         std::to_string(reached) +
                                         "; ask for at most that, or for a number k of spheres.");
  }

  Simplification in_order() const {
    std::size_t k = cover_.order.size();
    if (options_.iou) {
      const auto reaches = [&](std::uint64_t covered) {
        return static_cast<double>(covered) >= *options_.iou * static_cast<double>(object_.inside.count());
      };
      k = 1 + static_cast<std::size_t>(std::ranges::find_if(cover_.covered, reaches) - cover_.covered.begin());
      if (k > cover_.order.size()) {
        refuse_overlap(static_cast<double>(cover_.covered.back()) / static_cast<double>(object_.inside.count()), k - 1);
      }
    }
    Simplification s;
    Balls before;
    for (std::uint32_t i = 0; i < k; ++i) {
      context_.throw_if_cancelled();
      s.spheres.push_back({.sphere = pick(i),
                           .parent = i == 0 ? no_parent : nearest_by_power(before, pick(i).centre),
                           .from = i + 1,
                           .to = static_cast<std::uint32_t>(k)});
      before.push_back(pick(i));
    }
    return s;
  }

  static std::uint32_t nearest_by_power(const Balls& balls, Vec3 point) {
    const auto power = [&](const Sphere& b) { return squared_norm(point - b.centre) - b.radius * b.radius; };
    return static_cast<std::uint32_t>(std::ranges::min_element(balls, {}, power) - balls.begin());
  }

  // The best that is found from the first `count` of the order and, for a few, from as many clusters: one ball of
  // each, which may begin where the object has a hole. Finished as the mode wants it; LPS mm.
  Balls refined(std::uint32_t count, bool fine, const Context& context) const {
    Balls start;
    for (std::size_t i = 0; i < count; ++i) start.push_back(local_[cover_.order[i]]);
    Balls balls = refined_from(std::move(start), fine, context);
    if (count <= clusters_.last_level()) {
      start = spheres_at(clusters_, count);
      for (Sphere& ball : start) ball = detail::to_grid(object_.grid, ball);
      Balls other = refined_from(std::move(start), fine, context);
      if (measure_overlap(other, object_, context).iou() > measure_overlap(balls, object_, context).iou()) {
        balls = std::move(other);
      }
    }
    return options_.mode == BestOptions::Mode::outer ? around_all(std::move(balls), context)
                                                     : of_equal_volume(std::move(balls), context);
  }

  // As many rounds as some visits of every sample allow.
  static int rounds(double visits, const SampledObject& object, int least, int most) {
    const auto samples = static_cast<double>(object.inside.count());
    return static_cast<int>(std::clamp(visits / samples, double(least), double(most)));
  }

  // `fine`: with more work. From the grid's frame to LPS mm.
  Balls refined_from(Balls balls, bool fine, const Context& context) const {
    const auto candidates =
        std::span(local_).first(std::min(local_.size(), std::max<std::size_t>(32 * balls.size(), 512)));
    const SampledObject rough =
        working_copy(object_, fine ? kFewestSamples : 0.25 * kFewestSamples, balls.size(), context);
    const int steps = fine ? rounds(2.5e7, rough, 60, 100) : 30;
    // All at once as long as that helps: a ball of a few samples is too small for it.
    for (int round = 1; round <= 3; ++round) {
      Balls moved = detail::moved_together(balls, rough, steps / round, context);
      if (score(moved, rough, context) <= score(balls, rough, context)) break;
      Refinement work(rough, std::move(moved), context);
      const bool relocated = work.relocate(candidates);
      balls = work.balls();
      if (!relocated) break;
    }
    {
      Refinement work(rough, std::move(balls), context);
      for (int round = 0; round < (fine ? 4 : 2); ++round) {
        work.sweep(fine ? 8 : 3, 0.1);
        if (!work.relocate(candidates)) break;
      }
      balls = work.balls();
    }
    if (fine) {
      Refinement last(object_, std::move(balls), context);
      last.sweep(rounds(5e6, object_, 6, 20), 0.03);
      balls = last.balls();
    }
    for (Sphere& ball : balls) ball = to_patient(object_.grid, ball);
    return balls;
  }

  static double score(Balls balls, const SampledObject& object, const Context& context) {
    for (Sphere& ball : balls) ball = to_patient(object.grid, ball);
    return measure_overlap(balls, object, context).iou();
  }

  Balls of_equal_volume(Balls balls, const Context& context) const {
    const double volume = static_cast<double>(object_.inside.count()) * object_.sample_mm3();
    auto equal = calibrated(balls, volume, context);
    if (!equal) return balls;
    const double before = measure_overlap(balls, object_, context).iou();
    const double after = measure_overlap(*equal, object_, context).iou();
    return after >= before - kCalibrationCost ? std::move(*equal) : std::move(balls);
  }

  // Balls that hold every inside sample: each the smallest around the working samples in its power cell, again and
  // again while less is spilled, then grown to the rest.
  Balls around_all(Balls balls, const Context& context) const {
    Balls least;
    std::uint64_t spilled = 0;
    for (int round = 0; round < 8; ++round) {
      std::vector<Balls> cells(balls.size());
      const detail::BallTree tree(balls, context);
      Poll poll(context);
      visit_inside(working_, [&](Vec3 sample) {
        poll(64);
        cells[tree.nearest_by_power(sample)].push_back({sample, 0});
      });
      for (std::size_t i = 0; i < balls.size(); ++i) {
        context.throw_if_cancelled();
        if (!cells[i].empty()) balls[i] = smallest_enclosing_sphere(cells[i]);
      }
      balls = grown(std::move(balls), context);
      const std::uint64_t now = measure_overlap(balls, object_, context).spilled;
      if (round > 0 && now >= spilled) break;
      spilled = now;
      least = balls;
    }
    SPHERULE_AUDIT(covers_all(least, object_, context));
    return least;
  }
  Balls grown(Balls balls, const Context& context) const {
    const detail::BallTree tree(balls, context);
    Balls result = balls;
    Poll poll(context);
    for (const auto& sample : not_covered(balls, object_, context)) {
      poll(64);
      Sphere& ball = result[tree.nearest_by_power(object_.grid.to_patient(sample_place(object_, sample)))];
      ball.radius = radius_to_reach(ball.centre, ball.radius, sample, object_);
    }
    return result;
  }
  static Vec3 sample_place(const SampledObject& object, std::array<std::int32_t, 3> s) {
    return {s[0] * object.grid.spacing.x, s[1] * object.grid.spacing.y, s[2] * object.grid.spacing.z};
  }
  template <typename Visit>
  static void visit_inside(const SampledObject& object, Visit&& visit) {
    const auto [nx, ny, nz] = object.grid.dims;
    for (std::int32_t k = 0; k < nz; ++k) {
      for (std::int32_t j = 0; j < ny; ++j) {
        const auto row = object.inside.row(j, k);
        for (std::size_t w = 0; w < row.size(); ++w) {
          for (std::uint64_t bits = row[w]; bits != 0; bits &= bits - 1) {
            visit(object.grid.to_patient(
                sample_place(object, {static_cast<std::int32_t>(64 * w) + std::countr_zero(bits), j, k})));
          }
        }
      }
    }
  }

  // Makes the refined sets: of 1, 2, 4 … and of the wanted number of spheres.
  void refine() {
    const auto most = static_cast<std::uint32_t>(cover_.order.size());
    if (options_.iou) return refine_until_reached(most);
    for (std::uint32_t k = 1; k < most; k *= 2) counts_.push_back(k);
    counts_.push_back(most);
    sets_.resize(counts_.size());
    // The largest first; each on one thread.
    Context one{.threads = 1, .cancel = context_.cancel, .progress = {}};
    Context inside = context_;
    inside.progress = [&](std::string_view, double done) { context_.report("best", 0.2 + 0.7 * done); };
    parallel_for(inside, "best", counts_.size(), 1, [&](std::size_t begin, std::size_t) {
      const std::size_t level = counts_.size() - 1 - begin;
      sets_[level] = refined(counts_[level], begin == 0, one);
    });
  }
  void refine_until_reached(std::uint32_t most) {
    const auto overlap_of = [&](const Balls& balls) { return measure_overlap(balls, object_, quiet_).iou(); };
    std::uint32_t enough = 0;
    Balls best;
    for (std::uint32_t k = 1; enough == 0; k = std::min(2 * k, most)) {
      Balls balls = refined(k, true, quiet_);
      const double reached = overlap_of(balls);
      if (reached >= *options_.iou) {
        enough = k;
        best = std::move(balls);
      } else {
        if (k == most) refuse_overlap(reached, k);
        counts_.push_back(k);
        sets_.push_back(std::move(balls));
      }
    }
    // Fewer may do, to a part in sixteen.
    std::uint32_t less = counts_.empty() ? 0 : counts_.back();
    while (enough - less > std::max(1U, enough / 16)) {
      const std::uint32_t middle = less + (enough - less) / 2;
      Balls balls = refined(middle, true, quiet_);
      if (overlap_of(balls) >= *options_.iou) {
        enough = middle;
        best = std::move(balls);
      } else {
        less = middle;
      }
    }
    counts_.push_back(enough);
    sets_.push_back(std::move(best));
  }

  Simplification in_levels() const {
    Simplification s;
    Balls shown;                        // at the level before
    std::vector<std::uint32_t> places;  // of the shown ones in the result
    const auto add = [&](const Sphere& ball, std::uint32_t from, std::uint32_t to) {
      context_.throw_if_cancelled();
      const std::uint32_t parent = shown.empty() ? no_parent : places[nearest_by_power(shown, ball.centre)];
      s.spheres.push_back({.sphere = ball, .parent = parent, .from = from, .to = to});
      return static_cast<std::uint32_t>(s.spheres.size() - 1);
    };
    for (std::size_t level = 0; level < counts_.size(); ++level) {
      const bool last = level + 1 == counts_.size();
      const std::uint32_t from = counts_[level], to = last ? from : counts_[level + 1] - 1;
      std::vector<std::uint32_t> new_places;
      for (const Sphere& ball : sets_[level]) new_places.push_back(add(ball, from, to));
      shown = sets_[level];
      places = std::move(new_places);
      for (std::uint32_t k = from + 1; k <= to; ++k) {
        const std::uint32_t place = add(pick(k - 1), k, to);
        shown.push_back(pick(k - 1));
        places.push_back(place);
      }
    }
    return s;
  }

  void add_members(Simplification& s) const {
    const std::vector<std::uint32_t> last = shown_at(s, s.last_level());
    const Balls balls = spheres_at(s, s.last_level());
    const detail::BallTree tree(balls, context_);
    std::vector<std::uint32_t> of(model_.spheres.size());
    parallel_for(quiet_, {}, of.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t m = begin; m < end; ++m) of[m] = tree.nearest_by_power(model_.spheres[m].centre);
    });
    std::vector<std::vector<std::uint32_t>> members(balls.size());
    for (std::uint32_t m = 0; m < of.size(); ++m) members[of[m]].push_back(m);
    detail::LeafMembers leaves;
    for (std::size_t i = 0; i < last.size(); ++i) leaves.emplace_back(last[i], members[i]);
    detail::set_members(s, leaves);
  }

  const SphereModel& model_;
  const SampledObject& object_;
  const BestOptions& options_;
  const Context& context_;
  Context quiet_;  // for work within a step
  SampledObject working_;
  Balls candidates_, local_;  // LPS mm, and in the grid's frame
  detail::Cover cover_;
  Simplification clusters_;
  std::vector<std::uint32_t> counts_;  // of spheres in the refined sets, ascending
  std::vector<Balls> sets_;
};

}  // namespace

void check_options(const BestOptions& options, std::size_t model_count) {
  const auto refuse = [](const char* field, const char* sentence) {
    throw Error(ErrorCode::invalid_argument, sentence, {{field, sentence}});
  };
  if (options.k.has_value() == options.iou.has_value()) refuse("", "Give exactly one of k and iou.");
  if (options.iou && !(*options.iou > 0 && *options.iou <= 1)) {
    refuse("/iou", "Give iou as a number above 0 and at most 1.");
  }
  detail::require_k(options.k.value_or(1), model_count);
  if (options.k.value_or(1) > kMost) refuse("/k", "Give k as at most 65535 for the method best.");
}

BestSpheres best_spheres(const SphereModel& model, const SampledObject& object, const BestOptions& options,
                         const Context& context) {
  check_options(options, model.spheres.size());
  if (object.inside.count() == 0) {
    throw Error(ErrorCode::unusable, "The object has no samples to overlap with; choose a finer volume.");
  }
  return Best(model, object, options, context).run();
}

}  // namespace spherule
