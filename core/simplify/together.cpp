// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/together.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/base/elementary.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/simplify/frame.h"

namespace spherule::detail {

namespace {

// In voxels, from the first step to the last. What they are matters little: within half and twice of each, overlaps
// differ by less than 0.003.
constexpr double kSoftFirst = 1, kSoftLast = 0.4, kRateFirst = 0.5, kRateLast = 0.1;
constexpr double kMomentum = 0.8, kMemory = 0.95;  // Adam's beta 1 and 2
constexpr double kLeast = 0.1;                     // Adam's epsilon: samples a voxel of movement
constexpr double kLeastRadius = 0.5;               // voxels
constexpr std::size_t kSlices = 8;                 // in one piece of parallel work

using Gradient = std::array<double, 4>;  // by the centre, by the radius

class SoftBalls {
 public:
  SoftBalls(const SampledObject& object, const Context& context)
      : frame_(object, context), left_(frame_.value.size()) {}

  double voxel() const { return frame_.voxel; }

  // The gradient of the score by every ball, samples per mm.
  std::vector<Gradient> gradients(const std::vector<Sphere>& balls, double soft, const Context& context) {
    lay(balls, soft, context);
    std::vector<Gradient> result(balls.size());
    parallel_for(context, {}, balls.size(), 1,
                 [&](std::size_t begin, std::size_t) { result[begin] = gradient(balls[begin], soft, context); });
    return result;
  }

 private:
  // Of a row's samples within a ball and `soft` about it, those that are wholly in the ball; those before and after are
  // in its soft shell.
  static Run deep_in(const Sphere& ball, double soft, double across, double spacing, Run run) {
    const double inner = std::max(ball.radius - soft, 0.0), half = inner * inner - across;
    if (half <= 0) return {run.end, run.end};
    Run deep = samples_within(1 / spacing, ball.centre.x, std::sqrt(half), run.begin, run.end);
    if (deep.begin >= deep.end) return {run.end, run.end};
    return deep;
  }

  template <typename Visit>
  void visit_soft_rows(const Sphere& ball, double soft, const Window& window, Visit&& visit) const {
    const Vec3 spacing = frame_.spacing;
    visit_rows(spacing, {ball.centre, ball.radius + soft}, window, [&](std::int32_t j, std::int32_t k, Run run) {
      const double dy = j * spacing.y - ball.centre.y, dz = k * spacing.z - ball.centre.z;
      visit(frame_.at(0, j, k), dy, dz, run, deep_in(ball, soft, dy * dy + dz * dz, spacing.x, run));
    });
  }

  // What all balls leave out of each sample, 1 to 0. Slab by slab, so that products are formed in one order.
  void lay(const std::vector<Sphere>& balls, double soft, const Context& context) {
    const auto slices = static_cast<std::size_t>(frame_.window.size(2));
    parallel_for(context, {}, slices, kSlices, [&](std::size_t first, std::size_t last) {
      Window slab = frame_.window;
      slab.end[2] = slab.begin[2] + static_cast<std::int32_t>(last);
      slab.begin[2] += static_cast<std::int32_t>(first);
      std::fill(left_.begin() + static_cast<std::ptrdiff_t>(frame_.at(slab.begin[0], slab.begin[1], slab.begin[2])),
                left_.begin() + static_cast<std::ptrdiff_t>(frame_.at(slab.begin[0], slab.begin[1], slab.end[2])),
                1.0F);
      Poll poll(context);
      for (const Sphere& ball : balls) {
        poll(16);
        const auto per_soft = static_cast<float>(0.5 / soft), r = static_cast<float>(ball.radius);
        visit_soft_rows(ball, soft, slab, [&](std::size_t row, double dy, double dz, Run run, Run deep) {
          poll(16 + static_cast<std::uint64_t>(run.end - run.begin));
          float* left = left_.data() + row;
          const auto across = static_cast<float>(dy * dy + dz * dz), step = static_cast<float>(frame_.spacing.x),
                     x0 = static_cast<float>(ball.centre.x);
          const auto shell = [&](std::int32_t begin, std::int32_t end) {
            for (std::int32_t i = begin; i < end; ++i) {
              if (left[i] == 0) continue;
              const float dx = static_cast<float>(i) * step - x0;
              const float out = 0.5F + (std::sqrt(dx * dx + across) - r) * per_soft;
              left[i] *= std::clamp(out, 0.0F, 1.0F);
            }
          };
          shell(run.begin, deep.begin);
          std::fill(left + deep.begin, left + deep.end, 0.0F);
          shell(deep.end, run.end);
        });
      }
    });
  }

  Gradient gradient(const Sphere& ball, double soft, const Context& context) const {
    Poll poll(context);
    Gradient sum{0, 0, 0, 0};
    const auto per_soft = static_cast<float>(0.5 / soft), r = static_cast<float>(ball.radius);
    visit_soft_rows(ball, soft, frame_.window, [&](std::size_t row, double dy, double dz, Run run, Run deep) {
      poll(16 + static_cast<std::uint64_t>(run.end - run.begin));
      const float* left = left_.data() + row;
      const std::int8_t* value = frame_.value.data() + row;
      const auto across = static_cast<float>(dy * dy + dz * dz), step = static_cast<float>(frame_.spacing.x),
                 x0 = static_cast<float>(ball.centre.x);
      float along = 0, over = 0, all = 0;  // sums of dx/d, 1/d and 1, weighted
      // A sample may be the centre of a ball no wider than its shell.
      const float least = 1e-6F * step;
      const auto shell = [&](std::int32_t begin, std::int32_t end) {
        for (std::int32_t i = begin; i < end; ++i) {
          if (left[i] == 0) continue;
          const float dx = static_cast<float>(i) * step - x0, d = std::max(std::sqrt(dx * dx + across), least);
          const float out = 0.5F + (d - r) * per_soft;
          if (!(out > 0 && out < 1)) continue;
          const float w = static_cast<float>(value[i]) * left[i] / out;
          all += w;
          over += w / d;
          along += w * dx / d;
        }
      };
      shell(run.begin, deep.begin);
      shell(deep.end, run.end);
      sum[0] += static_cast<double>(along);
      sum[1] += dy * static_cast<double>(over);
      sum[2] += dz * static_cast<double>(over);
      sum[3] += static_cast<double>(all);
    });
    for (double& s : sum) s *= 0.5 / soft;
    return sum;
  }

  Frame frame_;
  std::vector<float> left_;
};

}  // namespace

std::vector<Sphere> moved_together(std::vector<Sphere> balls, const SampledObject& object, int steps,
                                   const Context& context) {
  SoftBalls soft_balls(object, context);
  const double voxel = soft_balls.voxel();
  std::vector<Gradient> mean(balls.size()), square(balls.size());
  double mean_missing = 1, square_missing = 1;  // of the averages' weight, as they begin at 0
  for (int s = 0; s < steps; ++s) {
    context.throw_if_cancelled();
    const double done = static_cast<double>(s) / steps;
    const double soft = voxel * kSoftFirst * elementary::pow(kSoftLast / kSoftFirst, done);
    const double rate = voxel * kRateFirst * elementary::pow(kRateLast / kRateFirst, done);
    const std::vector<Gradient> gradients = soft_balls.gradients(balls, soft, context);
    mean_missing *= kMomentum;
    square_missing *= kMemory;
    for (std::size_t i = 0; i < balls.size(); ++i) {
      std::array<double, 4> step{};
      for (std::size_t c = 0; c < step.size(); ++c) {
        const double g = voxel * gradients[i][c];
        mean[i][c] = kMomentum * mean[i][c] + (1 - kMomentum) * g;
        square[i][c] = kMemory * square[i][c] + (1 - kMemory) * g * g;
        step[c] = rate * mean[i][c] / (1 - mean_missing) / (std::sqrt(square[i][c] / (1 - square_missing)) + kLeast);
      }
      balls[i].centre = balls[i].centre + Vec3{step[0], step[1], step[2]};
      balls[i].radius = std::max(balls[i].radius + step[3], kLeastRadius * voxel);
    }
  }
  return balls;
}

}  // namespace spherule::detail
