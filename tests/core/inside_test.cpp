// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/inside.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::array kTypes = {VoxelType::uint8,   VoxelType::int8,   VoxelType::uint16, VoxelType::int16,
                               VoxelType::uint32,  VoxelType::int32,  VoxelType::uint64, VoxelType::int64,
                               VoxelType::float32, VoxelType::float64};

bool is_label(const Volume& volume, double value, double label) {
  const bool scaled = volume.slope != 1 || volume.intercept != 0;
  const bool whole = volume.slope == std::round(volume.slope) && volume.intercept == std::round(volume.intercept);
  const bool integral = volume.type != VoxelType::float32 && volume.type != VoxelType::float64;
  double tolerance = 0;
  if (scaled && !(whole && integral)) {
    tolerance = 0x1p-23 * (std::abs(value - volume.intercept) + std::abs(volume.intercept));
    if (integral && std::abs(volume.slope) < 1) tolerance += std::abs(volume.slope);
  }
  return std::abs(value - label) <= tolerance && std::abs(value - label) < 0.5;
}

// The definition of the object, one sample at a time. Labels of whole-numbered scaling have tests of their own.
bool is_inside(const Volume& volume, double value, const ObjectRule& rule) {
  if (!std::isfinite(value)) return false;
  bool member = false;
  switch (rule.kind) {
    case ObjectRule::Kind::threshold: member = value >= rule.lo; break;
    case ObjectRule::Kind::range: member = rule.lo <= value && value <= rule.hi; break;
    case ObjectRule::Kind::labels:
      for (const Label label : rule.labels) member |= is_label(volume, value, static_cast<double>(label));
      break;
  }
  return member == (rule.side == Side::above);
}

void expect_as_defined(const Volume& volume, const ObjectRule& rule, const Context& context = {}) {
  const InsideSamples samples = classify_samples(volume, rule, context);
  const auto [nx, ny, nz] = volume.grid.dims;
  ASSERT_EQ(samples.inside.dims(), volume.grid.dims);
  const bool has_above = rule.kind == ObjectRule::Kind::range;
  ASSERT_EQ(samples.above.words_per_row() != 0, has_above);
  std::uint64_t count = 0;
  for (std::int32_t k = 0; k < nz; ++k) {
    for (std::int32_t j = 0; j < ny; ++j) {
      for (std::int32_t i = 0; i < nx; ++i) {
        const double value = value_at(volume, i, j, k);
        count += is_inside(volume, value, rule);
        ASSERT_EQ(samples.inside.test(i, j, k), is_inside(volume, value, rule))
            << name(volume.type) << " value " << value << " lo " << rule.lo << " slope " << volume.slope;
        if (has_above) {
          ASSERT_EQ(samples.above.test(i, j, k), std::isfinite(value) && value > rule.hi) << name(volume.type);
        }
      }
      if (nx % 64 != 0) {
        ASSERT_EQ(samples.inside.row(j, k).back() >> (nx % 64), 0U) << "bits past the row's end";
      }
    }
  }
  EXPECT_EQ(samples.inside.count(), count);
}

// Random bits, few levels and the type's extremes: everything that a sample can be, NaN and infinities included.
Volume hostile(VoxelType type, std::int32_t nx, double slope, double intercept, std::uint64_t seed) {
  const Grid grid{.dims = {nx, 3, 2}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  Volume volume = phantoms::noise(grid, 8, seed, type);
  volume.slope = slope;
  volume.intercept = intercept;
  phantoms::Random random(seed + 1);
  visit_voxels(volume, [&]<typename T>(std::span<const T> samples) {
    using Limits = std::numeric_limits<T>;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      T value = samples[i];
      const std::uint64_t choice = random.below(4);
      const std::uint64_t bits = random.bits();
      if (choice == 0) std::memcpy(&value, &bits, sizeof(T));
      if (choice == 1) {
        const std::array<T, 4> extremes{Limits::max(), Limits::lowest(), Limits::infinity(), Limits::quiet_NaN()};
        value = extremes[bits % 4];
      }
      std::memcpy(volume.voxels.data() + i * sizeof(T), &value, sizeof(T));
    }
  });
  return volume;
}

TEST(Inside, FollowsItsDefinitionForEveryTypeSlopeAndRule) {
  std::uint64_t seed = 1;
  for (const VoxelType type : kTypes) {
    for (const std::int32_t nx : {1, 63, 64, 65, 130}) {
      for (const auto& [slope, intercept] : {std::pair{1.0, 0.0}, std::pair{-1.0, 0.0}, std::pair{0.1, -1024.0},
                                             std::pair{-1.0 / 255, 7.5}, std::pair{1e-30, 1.0}}) {
        const Volume volume = hostile(type, nx, slope, intercept, ++seed);
        phantoms::Random random(seed);
        const auto some_value = [&] {
          const double v =
              value_at(volume, static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(nx))),
                       static_cast<std::int32_t>(random.below(3)), static_cast<std::int32_t>(random.below(2)));
          if (!std::isfinite(v)) return 3 * slope + intercept;
          return std::array{v, std::nextafter(v, kInf), std::nextafter(v, -kInf)}[random.below(3)];
        };
        for (const Side side : {Side::above, Side::below}) {
          const double a = some_value(), b = some_value();
          if (!std::isfinite(a) || !std::isfinite(b)) continue;
          expect_as_defined(volume, phantoms::threshold(a, Border::closed, side));
          expect_as_defined(volume, phantoms::range(std::min(a, b), std::max(a, b), Border::closed, side));
          expect_as_defined(volume, phantoms::range(a, a, Border::closed, side));
          expect_as_defined(volume, phantoms::labels({-3, 0, 2, 5, 127}, Border::closed, side));
        }
        if (HasFatalFailure()) return;
      }
    }
  }
}

TEST(Inside, ThresholdsBeyondTheStoredTypeTakeAllOrNothing) {
  for (const VoxelType type : kTypes) {
    const Grid grid{.dims = {65, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
    const Volume volume = phantoms::noise(grid, 100, 5, type);
    EXPECT_EQ(classify_samples(volume, phantoms::threshold(-1e300)).inside.count(), 65U) << name(type);
    EXPECT_EQ(classify_samples(volume, phantoms::threshold(1e300)).inside.count(), 0U) << name(type);
    EXPECT_EQ(classify_samples(volume, phantoms::threshold(1e300, Border::closed, Side::below)).inside.count(), 65U);
    EXPECT_EQ(classify_samples(volume, phantoms::range(-1e300, 1e300)).inside.count(), 65U);
  }
}

TEST(Inside, LabelsBeyondDoublePrecisionAreNotMistakenForTheirNeighbours) {
  const Grid grid{.dims = {2, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  Volume volume = phantoms::noise(grid, 1, 0, VoxelType::int64);
  phantoms::set_stored(volume, {0, 0, 0}, 0x1p52);
  phantoms::set_stored(volume, {1, 0, 0}, 0x1p52 + 1);
  const auto samples = classify_samples(volume, phantoms::labels({(std::int64_t{1} << 52) + 1}));
  EXPECT_FALSE(samples.inside.test(0, 0, 0));
  EXPECT_TRUE(samples.inside.test(1, 0, 0));
}

TEST(Inside, LabelsOf64BitIntegersAreComparedAsIntegers) {
  const Grid grid{.dims = {4, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const auto inside = [&](VoxelType type, auto values, double slope, double intercept, Label label) {
    Volume volume = phantoms::noise(grid, 1, 0, type);
    std::memcpy(volume.voxels.data(), values.data(), sizeof values);
    volume.slope = slope, volume.intercept = intercept;
    const SampleBits bits = classify_samples(volume, phantoms::labels({label})).inside;
    std::string found;
    for (std::int32_t i = 0; i < 4; ++i) found += bits.test(i, 0, 0) ? '1' : '0';
    return found;
  };
  constexpr std::int64_t kBig = (std::int64_t{1} << 60) + 7;
  constexpr std::array<std::int64_t, 4> near{kBig, kBig + 1, -kBig, -kBig - 1};
  EXPECT_EQ(inside(VoxelType::int64, near, 1, 0, kBig), "1000");
  EXPECT_EQ(inside(VoxelType::int64, near, 1, 0, kBig + 1), "0100");
  EXPECT_EQ(inside(VoxelType::int64, near, 1, 0, -kBig - 1), "0001");
  EXPECT_EQ(inside(VoxelType::int64, near, -2, 5, Label{-2} * kBig + 3), "0100");
  constexpr std::uint64_t kHuge = (std::uint64_t{1} << 63) + 5;
  constexpr std::array<std::uint64_t, 4> huge{kHuge, kHuge + 1, UINT64_MAX, UINT64_MAX - 1};
  EXPECT_EQ(inside(VoxelType::uint64, huge, 1, 0, kHuge), "1000");
  EXPECT_EQ(inside(VoxelType::uint64, huge, 1, 0, max_label), "0010");
}

TEST(Inside, ScaledLabelMapsMatchTheirLabels) {
  // As libraries pack floating labels into int16: the range of values over the range of stored numbers, in float32.
  for (const auto& [lowest, highest] : {std::pair{0.0, 3.0}, {0.0, 117.0}, {-4.0, 40.0}, {1.0, 30000.0}}) {
    const auto slope = static_cast<double>(static_cast<float>((highest - lowest) / 65535));
    const auto intercept = static_cast<double>(static_cast<float>(lowest + 32768 * slope));
    const std::int32_t count = static_cast<std::int32_t>(highest - lowest) + 1;
    const Grid grid{.dims = {count, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
    Volume volume = phantoms::noise(grid, 1, 0, VoxelType::int16);
    volume.slope = slope, volume.intercept = intercept;
    for (std::int32_t i = 0; i < count; ++i)
      phantoms::set_stored(volume, {i, 0, 0}, std::round((lowest + i - intercept) / slope));
    for (std::int32_t i = 0; i < count; i += std::max(1, count / 50)) {
      const SampleBits bits = classify_samples(volume, phantoms::labels({static_cast<Label>(lowest) + i})).inside;
      EXPECT_EQ(bits.count(), 1U) << lowest + i;
      EXPECT_TRUE(bits.test(i, 0, 0)) << lowest + i;
    }
  }
}

TEST(Inside, ScaledValuesBetweenLabelsAreNone) {
  const Grid grid{.dims = {2, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  Volume volume = phantoms::noise(grid, 1, 0, VoxelType::int16);
  phantoms::set_stored(volume, {0, 0, 0}, 1);
  phantoms::set_stored(volume, {1, 0, 0}, 2);
  const auto count = [&](double slope, double intercept, Label label) {
    volume.slope = slope, volume.intercept = intercept;
    return classify_samples(volume, phantoms::labels({label})).inside.count();
  };
  EXPECT_EQ(count(2, 0, 3), 0U) << "values 2 and 4";
  EXPECT_EQ(count(2, 0, 4), 1U);
  EXPECT_EQ(count(1, 0.5, 1), 0U) << "values 1.5 and 2.5";
  EXPECT_EQ(count(1, 0.5, 2), 0U);
  EXPECT_EQ(count(0.3, 0, 0), 1U) << "values 0.3 and 0.6";
  EXPECT_EQ(count(0.1, 0.1, 0), 0U) << "values 0.2 and 0.3";
}

TEST(Inside, LabelsAreReadFromDigitsWithoutLoss) {
  EXPECT_EQ(parse_label("9223372036854775813"), (Label{1} << 63) + 5);
  for (const Label label : {min_label, Label{-1}, Label{0}, max_label}) EXPECT_EQ(parse_label(to_text(label)), label);
  for (const char* text : {"", "-", "+1", "1.0", "1e3", " 1", "1 ", "18446744073709551616", "-9223372036854775809"})
    EXPECT_FALSE(parse_label(text)) << text;
}

TEST(Inside, ValuesThatAreNotFiniteAreOutsideOnEitherSide) {
  const Grid grid{.dims = {4, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  Volume volume = phantoms::sample([](Vec3) { return 5; }, grid);
  const std::array<double, 4> values{kNaN, kInf, -kInf, 5};
  std::memcpy(volume.voxels.data(), values.data(), sizeof values);
  for (const Side side : {Side::above, Side::below}) {
    const double lo = side == Side::above ? 1 : 9;
    for (const ObjectRule& rule :
         {phantoms::threshold(lo, Border::closed, side), phantoms::range(lo, lo + 5, Border::closed, side),
          phantoms::labels({side == Side::above ? 5 : 4}, Border::closed, side)}) {
      const SampleBits inside = classify_samples(volume, rule).inside;
      EXPECT_EQ(inside.count(), 1U);
      EXPECT_TRUE(inside.test(3, 0, 0));
    }
  }
}

TEST(Inside, IsTheSameForEveryThreadCount) {
  const Grid grid{.dims = {70, 40, 30}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const Volume volume = phantoms::noise(grid, 50, 9, VoxelType::uint16);
  for (unsigned threads = 1; threads <= 4; ++threads) {
    Context context;
    context.threads = threads;
    expect_as_defined(volume, phantoms::range(10, 20), context);
  }
}

TEST(Inside, RefusesRulesThatMakeNoSense) {
  const Grid grid{.dims = {2, 2, 2}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const Volume volume = phantoms::noise(grid, 5, 1);
  for (const ObjectRule& rule : {phantoms::threshold(kNaN), phantoms::threshold(kInf), phantoms::range(-kInf, 3),
                                 phantoms::range(3, kNaN), phantoms::range(3, 2), phantoms::labels({})}) {
    try {
      classify_samples(volume, rule);
      FAIL() << "accepted";
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
      ASSERT_EQ(error.fields().size(), 1U);
      EXPECT_EQ(error.fields()[0].pointer.front(), '/');
    }
  }
}

TEST(SampleBits, KnowWhenTheyFillTheirBox) {
  const auto bits = [](std::array<std::int32_t, 3> dims, const auto& outside) {
    const Volume volume = phantoms::sample([&](Vec3 p) { return outside(p) ? 0.0 : 1.0; },
                                           {.dims = dims, .spacing = {1, 1, 1}, .origin = {}, .direction = {}});
    return classify_samples(volume, phantoms::threshold(0.5)).inside;
  };
  const auto none = [](Vec3) { return false; };
  for (const auto& dims : {std::array{1, 1, 1}, {64, 1, 3}, {65, 7, 2}, {20, 20, 20}})
    EXPECT_TRUE(fills_its_box(bits(dims, none)));
  // 8000 samples, 2168 of them in the outermost layer.
  const auto specks = [](int count, int j) { return [=](Vec3 p) { return p.z == 5 && p.y == j && p.x < count; }; };
  EXPECT_TRUE(fills_its_box(bits({20, 20, 20}, [](Vec3 p) { return p.z == 5 && p.y == 5 && p.x > 5 && p.x < 14; })));
  EXPECT_FALSE(fills_its_box(bits({20, 20, 20}, [](Vec3 p) { return p.z == 5 && p.y == 5 && p.x > 5 && p.x < 15; })));
  EXPECT_TRUE(fills_its_box(bits({20, 20, 20}, specks(2, 0))));
  EXPECT_FALSE(fills_its_box(bits({20, 20, 20}, specks(3, 0)))) << "in the outermost layer";
  const auto free = [](Vec3 p) { return p.x == 0 || p.y == 0 || p.z == 0 || p.x == 99 || p.y == 99 || p.z == 99; };
  EXPECT_FALSE(fills_its_box(bits({100, 100, 100}, free)));
  EXPECT_FALSE(fills_its_box(bits({100, 100, 100}, [](Vec3 p) { return p.x < 50; })));
}

TEST(SampleBits, SamplesOutsideTheGridCountAsZero) {
  SampleBits bits({65, 2, 2});
  for (std::int32_t k = 0; k < 2; ++k) {
    for (std::int32_t j = 0; j < 2; ++j) bits.row(j, k)[0] = ~std::uint64_t{0}, bits.row(j, k)[1] = 1;
  }
  EXPECT_EQ(bits.count(), 65U * 4);
  EXPECT_TRUE(bits.test_or_outside(64, 1, 1));
  for (const auto [i, j, k] : {std::array{-1, 0, 0}, std::array{65, 0, 0}, std::array{0, -1, 0}, std::array{0, 2, 0},
                               std::array{0, 0, -1}, std::array{0, 0, 2}})
    EXPECT_FALSE(bits.test_or_outside(i, j, k));
}

}  // namespace
}  // namespace spherule
