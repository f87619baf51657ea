// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/lattice.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/phantoms.h"

namespace spherule {
namespace {

Grid grid_of(std::array<std::int32_t, 3> dims, Vec3 spacing) {
  return {.dims = dims, .spacing = spacing, .origin = {}, .direction = {}};
}

TEST(Lattice, PlanesAscendWithinTheLatticeAndNearTheirTruePlaces) {
  phantoms::Random random(4);
  for (int n = 0; n < 300; ++n) {
    Grid grid;
    for (int a = 0; a < 3; ++a) {
      grid.dims[static_cast<std::size_t>(a)] = static_cast<std::int32_t>(1 + random.below(300));
      grid.spacing[a] = std::exp(6 * random.unit() - 3);
    }
    const Lattice lattice = make_lattice(grid);
    ASSERT_GT(lattice.unit_mm, 0);
    for (int a = 0; a < 3; ++a) {
      const auto& planes = lattice.planes[static_cast<std::size_t>(a)];
      ASSERT_EQ(planes.size(), static_cast<std::size_t>(grid.dims[static_cast<std::size_t>(a)]) + 2);
      EXPECT_EQ(planes.front(), 0);
      EXPECT_LT(planes.back(), 1 << Lattice::coordinate_bits);
      for (std::size_t p = 0; p < planes.size(); ++p) {
        const double true_place = static_cast<double>(p) * grid.spacing[a] / lattice.unit_mm;
        // Half a unit, and what double leaves of 24 bits.
        ASSERT_LE(std::abs(planes[p] - true_place), 0.5 + 1e-6);
        // At least 64 units a step, each plane half a unit off.
        if (p > 0) {
          ASSERT_GE(planes[p] - planes[p - 1], 63);
        }
      }
    }
  }
}

TEST(Lattice, EqualSpacingsAreExactAndHalfAVoxelIsALatticePoint) {
  for (const std::int32_t n : {1, 2, 3, 17, 181, 1024, 4096}) {
    const Lattice lattice = make_lattice(grid_of({n, 1 + n / 2, 1}, {0.7, 0.7, 0.7}));
    const std::int32_t step = lattice.plane(0, 0) - lattice.plane(0, -1);
    EXPECT_EQ(step % 2, 0);
    for (int a = 0; a < 3; ++a) {
      for (std::int32_t i = -1; i <= lattice.grid.dims[static_cast<std::size_t>(a)]; ++i)
        ASSERT_EQ(lattice.plane(a, i), (i + 1) * step);
    }
    EXPECT_NEAR(lattice.unit_mm * step, 0.7, 1e-15);
    // The finest such lattice: two units more a step would not fit.
    EXPECT_GE((std::int64_t{step} + 2) * (n + 1), std::int64_t{1} << 24);
  }
}

TEST(Lattice, SamplesMapToTheirPlaceInThePatient) {
  Grid grid = grid_of({10, 20, 30}, {0.5, 1.25, 3});
  grid.origin = {100, -50, 7};
  const double c = std::cos(0.3), s = std::sin(0.3);
  grid.direction = {{Vec3{c, -s, 0}, Vec3{s, c, 0}, Vec3{0, 0, -1}}};
  const Lattice lattice = make_lattice(grid);
  EXPECT_EQ(lattice.to_patient(LatticePoint{lattice.plane(0, 0), lattice.plane(1, 0), lattice.plane(2, 0)}),
            grid.origin);
  const LatticePoint p{lattice.plane(0, 9), lattice.plane(1, 19), lattice.plane(2, 29)};
  EXPECT_NEAR(norm(lattice.to_patient(p) - grid.to_patient({9 * 0.5, 19 * 1.25, 29 * 3.0})), 0, lattice.unit_mm);
}

TEST(Lattice, RefusesWhatItCannotHoldExactly) {
  const auto refused = [](const Grid& grid) {
    try {
      make_lattice(grid);
    } catch (const Error& error) {
      return error.code() == ErrorCode::unusable;
    }
    return false;
  };
  EXPECT_FALSE(refused(grid_of({262'000, 1, 1}, {1, 1, 1})));
  EXPECT_TRUE(refused(grid_of({263'000, 1, 1}, {1, 1, 1})));
  // 2^24 / 64 = 262,144 of the smallest spacings fit the longest axis.
  EXPECT_FALSE(refused(grid_of({10, 10, 10}, {1, 1, 20'000})));
  EXPECT_TRUE(refused(grid_of({10, 10, 10}, {1, 1, 25'000})));
  EXPECT_TRUE(refused(grid_of({1, 1, 1}, {1e-300, 1, 1e300})));
  EXPECT_TRUE(refused(grid_of({2'147'483'647, 1, 1}, {1, 1, 1})));
}

}  // namespace
}  // namespace spherule
