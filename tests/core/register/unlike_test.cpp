// SPDX-License-Identifier: GPL-3.0-or-later
//
// Sets that have little to do with each other: the answer is a transform that can be undone, or a sentence.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "core/register/register.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

SphereModel scaled_set(const std::vector<Sphere>& balls, double scale, double away) {
  SphereModel model;
  for (const Sphere& b : balls) model.spheres.push_back({scale * b.centre + Vec3{away, -away, away}, scale * b.radius});
  return model;
}

std::vector<std::pair<std::string, std::vector<Sphere>>> sets() {
  phantoms::Random random(3);
  std::vector<Sphere> cloud, line, plane, dust;
  for (int i = 0; i < 10; ++i) {
    cloud.push_back({{random.unit(), random.unit(), random.unit()}, 0.1 + 0.2 * random.unit()});
    line.push_back({{random.unit(), 0, 0}, 1e-6});
    plane.push_back({{random.unit(), random.unit(), 0}, 1e-6});
    dust.push_back({{random.unit(), random.unit(), random.unit()}, std::pow(10.0, -9 * random.unit())});
  }
  return {{"cloud", cloud}, {"line", line}, {"plane", plane}, {"dust", dust}, {"one", {{{0, 0, 0}, 1}}}};
}

void expect_answer(const SphereModel& fixed, const SphereModel& moving, const RegistrationOptions& options,
                   const std::string& what) {
  try {
    const Registration found = register_models(fixed, moving, options);
    EXPECT_TRUE(is_proper(found.moving_to_fixed)) << what;
    const Decomposition parts = decompose(found.moving_to_fixed, found.centre);
    EXPECT_TRUE(std::isfinite(norm(parts.translation)) && std::isfinite(norm(parts.shear))) << what;
    EXPECT_GT(scale_of(found.moving_to_fixed), 0) << what;
    decompose(inverse(found.moving_to_fixed), {});
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::unusable) << what << ": " << e.what();
  }
}

TEST(Register, OfSetsUnlikeInSizeAndShapeIsATransformOrASentence) {
  const auto all = sets();
  const std::array scales{std::pair{1.0, 1.0}, std::pair{1e9, 1e-9}, std::pair{1e-9, 1e9}, std::pair{1e-9, 1e-9}};
  std::size_t n = 0;
  constexpr std::array kinds{TransformKind::rigid, TransformKind::similarity, TransformKind::affine};
  for (std::size_t f = 0; f < all.size(); ++f) {
    for (const std::size_t m : {f, (f + 1) % all.size(), (f + 2) % all.size()}) {
      // Kinds, scales and methods in turn.
      const auto& [fixed_scale, moving_scale] = scales[n % scales.size()];
      RegistrationOptions options{
          .transform = kinds[n % kinds.size()], .k = 8, .inits = 1, .min_scale = 1e-9, .max_scale = 1e9};
      if (n % 2 == 0) options.method = RegistrationMethod::matching;
      options.refine = n % 5 != 0;
      const double away = n % 7 == 0 ? 1e9 : 0;
      expect_answer(scaled_set(all[f].second, fixed_scale, 0), scaled_set(all[m].second, moving_scale, away), options,
                    all[m].first + " to " + all[f].first + ", number " + std::to_string(n));
      ++n;
    }
  }
}

TEST(Transform, ScalesBeyondTheCubeRootOfWhatNumbersHold) {
  for (const double scale : {1e-150, 1e-9, 1.0, 1e9, 1e150}) {
    const AffineMap map{spherule::scaled(scale, Mat3{}), {}};
    EXPECT_TRUE(is_proper(map)) << scale;
    EXPECT_DOUBLE_EQ(scale_of(map), scale);
    EXPECT_DOUBLE_EQ(decompose(map, {}).scales.x, scale);
  }
  EXPECT_FALSE(is_proper({Mat3{{Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, -1}}}, {}}));
  EXPECT_FALSE(is_proper({Mat3{{Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{1, 1, 0}}}, {}}));
  EXPECT_FALSE(is_proper({{}, {std::nan(""), 0, 0}}));
}

}  // namespace
}  // namespace spherule
