// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/model_blob.h"

#include <gtest/gtest.h>

#include <cstring>

#include "core/pipeline.h"
#include "tests/phantoms.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using test::MemoryBlobStore;

std::string bytes_of(const SphereModel& model) {
  std::string bytes;
  write_model(model, [&](std::string_view piece) {
    EXPECT_LE(piece.size(), std::size_t{4} << 20);
    bytes += piece;
  });
  return bytes;
}

SphereModel model_of(const std::string& bytes) {
  MemoryBlobStore store;
  const Blob blob = store.open(store.put("models/m", bytes));
  return read_model(blob);
}

SphereModel torus() {
  Grid grid = phantoms::cubic_grid(24, 30);
  grid.origin = {-100, 20.5, 3};
  const Vec3 centre = grid.to_patient({11.5 * grid.spacing.x, 11.5 * grid.spacing.y, 11.5 * grid.spacing.z});
  return build_model(phantoms::sample(phantoms::torus(centre, 8, 3), grid), phantoms::threshold(0)).model;
}

SphereModel imported() { return {.spheres = {{{1, 2, 3}, 4}, {{-0.5, 0, 1e300}, 0}}, .solid = {}}; }

// Two spheres that one at first stands for, of five with one left out.
Simplification simplified() {
  Simplification s;
  s.spheres = {{.sphere = {{1, 2, 3}, 4}, .from = 1, .to = 1},
               {.sphere = {{1, 2, 2}, 2}, .parent = 0, .from = 2, .to = 2},
               {.sphere = {{1, 2, 4}, 0}, .parent = 0, .from = 2, .to = 2}};
  s.member_begin = {0, 0, 1, 4};
  s.members = {3, 0, 1, 4};
  return s;
}
std::string bytes_of(const Simplification& levels) {
  std::string bytes;
  write_levels(levels, [&](std::string_view piece) { bytes += piece; });
  return bytes;
}
Simplification levels_of(const std::string& bytes) {
  MemoryBlobStore store;
  const Blob blob = store.open(store.put("models/m", bytes));
  return read_levels(blob);
}

void expect_corrupt(const std::string& bytes, const std::string& what) {
  try {
    static_cast<void>(model_of(bytes));
    ADD_FAILURE() << "was read: " << what;
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::corrupt) << what;
  }
}

TEST(ModelBlob, GivesARawModelBackBitForBit) {
  const SphereModel model = torus();
  const SphereModel again = model_of(bytes_of(model));
  ASSERT_TRUE(again.solid);
  ASSERT_GT(model.spheres.size(), 100U);
  EXPECT_EQ(again.spheres, model.spheres) << "made again from the integers";
  EXPECT_EQ(again.solid->cells, model.solid->cells);
  EXPECT_EQ(again.solid->inside_count, model.solid->inside_count);
  EXPECT_EQ(again.solid->boundary.points, model.solid->boundary.points);
  EXPECT_EQ(again.solid->boundary.touches_border, model.solid->boundary.touches_border);
  EXPECT_EQ(again.solid->boundary.lattice.planes, model.solid->boundary.lattice.planes);
  EXPECT_EQ(again.solid->boundary.lattice.unit_mm, model.solid->boundary.lattice.unit_mm);
  EXPECT_EQ(again.solid->boundary.lattice.grid.dims, model.solid->boundary.lattice.grid.dims);
  EXPECT_EQ(again.solid->boundary.lattice.grid.origin, model.solid->boundary.lattice.grid.origin);
  EXPECT_EQ(bytes_of(again), bytes_of(model));
}

TEST(ModelBlob, GivesImportedSpheresBack) {
  const SphereModel again = model_of(bytes_of(imported()));
  EXPECT_FALSE(again.solid);
  EXPECT_EQ(again.spheres, imported().spheres);
  EXPECT_EQ(model_of(bytes_of(SphereModel{})).spheres.size(), 0U);
}

TEST(ModelBlob, GivesASimplifiedModelBackWithItsLevels) {
  const std::string bytes = bytes_of(simplified());
  EXPECT_EQ(bytes.size(), 8 + 4 + 4 + 8 + 8 + 3 * 32 + 3 * 12 + 4 * 4 + 4 * 4U);
  EXPECT_EQ(levels_of(bytes), simplified());
  const SphereModel model = model_of(bytes);
  EXPECT_FALSE(model.solid);
  EXPECT_EQ(model.spheres, spheres_at(simplified(), 2)) << "the last level";
  EXPECT_THROW(static_cast<void>(levels_of(bytes_of(imported()))), Error);
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    expect_corrupt(bytes.substr(0, size), "cut at " + std::to_string(size));
  }
  expect_corrupt(bytes + "x", "with more at the end");
  const auto with = [&](std::size_t at, auto value) {
    std::string changed = bytes;
    std::memcpy(changed.data() + at, &value, sizeof value);
    return changed;
  };
  expect_corrupt(with(16, ~std::uint64_t{0}), "a count beyond the bytes");
  expect_corrupt(with(24, std::uint64_t{1} << 62), "a count that overflows");
  expect_corrupt(with(32 + 24, -1.0), "a negative radius");
  expect_corrupt(with(128 + 12, std::uint32_t{2}), "a parent that comes later");
  expect_corrupt(with(128 + 2 * 12 + 8, ~std::uint32_t{0}), "a level that no sphere fills");
  expect_corrupt(with(164 + 4, ~std::uint32_t{0}), "members that begin beyond all");
  expect_corrupt(with(180, ~std::uint32_t{0}), "a member beyond any model");
  expect_corrupt(with(180, std::uint32_t{0}), "a member twice");
}

TEST(ModelBlob, IsAsItsHeaderSays) {
  const std::string bytes = bytes_of(imported());
  std::string expected = "SPHERULE";
  const auto put = [&](auto value) { expected.append(reinterpret_cast<const char*>(&value), sizeof value); };
  put(std::uint32_t{1});
  put(std::uint32_t{2});
  put(std::uint64_t{2});
  for (const double number : {1., 2., 3., 4., -0.5, 0., 1e300, 0.}) put(number);
  EXPECT_EQ(bytes, expected);
  const SphereModel model = torus();
  const Solid& solid = *model.solid;
  EXPECT_EQ(bytes_of(model).size(), 8 + 4 + 4 + 12 + 24 + 24 + 72 + 8 + 3 * 26 * 4 + 4 * 8 +
                                        12 * solid.boundary.points.size() + 16 * solid.cells.size());
}

TEST(ModelBlob, RefusesEveryCut) {
  const std::string bytes = bytes_of(torus());
  for (std::size_t size = 0; size < 600; ++size)
    expect_corrupt(bytes.substr(0, size), "cut at " + std::to_string(size));
  expect_corrupt(bytes.substr(0, bytes.size() - 1), "cut at the end");
  expect_corrupt(bytes + "x", "with more at the end");
  expect_corrupt(bytes_of(imported()) + "x", "with more at the end");
}

TEST(ModelBlob, RefusesNumbersThatMakeNoSense) {
  const std::string raw = bytes_of(torus()), plain = bytes_of(imported());
  const auto with = [](std::string bytes, std::size_t at, auto value) {
    std::memcpy(bytes.data() + at, &value, sizeof value);
    return bytes;
  };
  expect_corrupt(with(raw, 0, 'x'), "another magic");
  expect_corrupt(with(raw, 8, std::uint32_t{2}), "another version");
  expect_corrupt(with(raw, 12, std::uint32_t{4}), "another kind");
  expect_corrupt(with(raw, 16, std::int32_t{-1}), "a negative size");
  expect_corrupt(with(raw, 16, std::int32_t{0x7fffffff}), "a size beyond the bytes");
  expect_corrupt(with(raw, 148, 0.0), "no unit");
  const std::size_t counts = 156 + 3 * 26 * 4;
  for (std::size_t i = 1; i < 4; ++i) {
    expect_corrupt(with(raw, counts + 8 * i, ~std::uint64_t{0}), "a count beyond the bytes");
    expect_corrupt(with(raw, counts + 8 * i, std::uint64_t{1} << 60), "a count that overflows");
  }
  expect_corrupt(with(raw, counts + 32, std::int32_t{-1}), "a point outside the lattice");
  expect_corrupt(with(raw, raw.size() - 4, std::uint32_t{0x7fffffff}), "a corner that is no point");
  expect_corrupt(with(plain, 16, ~std::uint64_t{0}), "a count beyond the bytes");
  expect_corrupt(with(plain, 16, (std::uint64_t{1} << 59) + 2), "a count that overflows");
  expect_corrupt(with(plain, 48, -1.0), "a negative radius");
  expect_corrupt(with(plain, 24, std::numeric_limits<double>::quiet_NaN()), "no number");
}

TEST(ModelBlob, TellsItsMemory) {
  const SphereModel model = torus();
  EXPECT_GE(bytes_in_memory(model), 32 * model.spheres.size() + 16 * model.solid->cells.size());
  EXPECT_LE(bytes_in_memory(model), 2 * (32 * model.spheres.size() + 16 * model.solid->cells.size() +
                                         12 * model.solid->boundary.points.size() + 4096));
}

}  // namespace
}  // namespace spherule::server
