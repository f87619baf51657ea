// SPDX-License-Identifier: GPL-3.0-or-later
#include <openvdb/io/File.h>
#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointDataGrid.h>
#include <openvdb/tools/LevelSetSphere.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <random>
#include <sstream>
#include <type_traits>

#include "tests/read/files.h"

namespace spherule::test {
namespace {

namespace vdb = openvdb;

constexpr std::uint32_t kCompressions[] = {vdb::io::COMPRESS_NONE, vdb::io::COMPRESS_ZIP,
                                           vdb::io::COMPRESS_BLOSC | vdb::io::COMPRESS_ACTIVE_MASK};

std::string vdb_bytes(const vdb::GridCPtrVec& grids, std::uint32_t compression = vdb::io::COMPRESS_ACTIVE_MASK) {
  vdb::initialize();
  const TempFolder folder;
  const auto path = folder.path() / "made.vdb";
  vdb::io::File file(path.string());
  file.setCompression(compression);
  file.write(grids);
  file.close();
  return bytes_of_file(path);
}

Volume read(const std::string& bytes, const ReadOptions& options = {}) {
  const TempFolder folder;
  return read_volume({folder.add("doe.vdb", bytes)}, options);
}

void refuse(const std::string& bytes, ErrorCode code, const ReadOptions& options = {}) {
  const TempFolder folder;
  expect_refused_cheaply({folder.add("doe.vdb", bytes)}, code, options);
}

// Made by the library, and all that is virtual called through its base class: to compile a grid's every function here
// would take minutes.
template <typename GridType>
typename GridType::Ptr make_grid(
    typename GridType::ValueType background = vdb::zeroVal<typename GridType::ValueType>()) {
  vdb::initialize();
  const auto grid = vdb::gridPtrCast<GridType>(vdb::GridBase::createGrid(GridType::gridType()));
  grid->tree().root().setBackground(background, false);
  return grid;
}

// Active voxels in the box (1, -2, 3) … (9, 5, 12), with telling values; a tile of 8³ far off the origin within them.
template <typename GridType>
typename GridType::Ptr telling_grid(const std::string& name = "density") {
  using T = typename GridType::ValueType;
  const auto grid = make_grid<GridType>(T(1));
  grid->setName(name);
  int n = 0;
  for (int k = 3; k <= 12; ++k) {
    for (int j = -2; j <= 5; ++j) {
      for (int i = 1; i <= 9; ++i, ++n) grid->tree().setValue({i, j, k}, T(n % 3 ? n : 0));
    }
  }
  return grid;
}

template <typename GridType, typename Stored>
void expect_telling(const Volume& volume, const GridType& grid) {
  ASSERT_EQ(volume.grid.dims, (std::array{11, 10, 12}));
  const auto values = samples<Stored>(volume);
  std::size_t at = 0;
  for (int k = 2; k <= 13; ++k) {
    for (int j = -3; j <= 6; ++j) {
      for (int i = 0; i <= 10; ++i) {
        ASSERT_EQ(values[at++], static_cast<Stored>(grid.tree().getValue({i, j, k}))) << i << " " << j << " " << k;
      }
    }
  }
}

TEST(OpenVdb, ReadsEveryTypeInEveryCompression) {
  const auto check = [&]<typename GridType, typename Stored>(std::type_identity<GridType>, Stored) {
    const auto grid = telling_grid<GridType>();
    for (const std::uint32_t compression : kCompressions) {
      const Volume volume = read(vdb_bytes({grid}, compression));
      expect_telling<GridType, Stored>(volume, *grid);
      EXPECT_EQ(volume.format, "openvdb");
      EXPECT_EQ(volume.natural_side, Side::above);
      EXPECT_TRUE(warns(volume, "taken as mm"));
    }
  };
  check(std::type_identity<vdb::FloatGrid>(), float{});
  check(std::type_identity<vdb::DoubleGrid>(), double{});
  check(std::type_identity<vdb::Int32Grid>(), std::int32_t{});
  check(std::type_identity<vdb::Int64Grid>(), std::int64_t{});
  check(std::type_identity<vdb::BoolGrid>(), std::uint8_t{});
}

TEST(OpenVdb, ReadsHalfFloats) {
  const auto grid = telling_grid<vdb::FloatGrid>();
  grid->setSaveFloatAsHalf(true);
  expect_telling<vdb::FloatGrid, float>(read(vdb_bytes({grid})), *grid);  // 0 … 719 are exact in half precision
}

TEST(OpenVdb, SetsTheSideByTheGridsClassAndKeepsTheInside) {
  const auto level_set = vdb::tools::createLevelSetSphere<vdb::FloatGrid>(3.0F, {1, 2, 3}, 0.25F, 3.0F);
  const Volume volume = read(vdb_bytes({level_set}));
  EXPECT_EQ(volume.natural_side, Side::below);
  const auto [x, y, z] = volume.grid.dims;
  EXPECT_EQ(x, y);
  EXPECT_EQ(y, z);
  expect_near(volume.grid.spacing, {0.25, 0.25, 0.25}, 1e-12);
  // Deep inside, no voxel is active; the corner is outside.
  EXPECT_EQ(value_at(volume, x / 2, y / 2, z / 2), -0.75);
  EXPECT_EQ(value_at(volume, 0, 0, 0), 0.75);
  expect_near(volume.grid.to_patient(0.125 * Vec3{x - 1.0, y - 1.0, z - 1.0}), {1, 2, 3}, 1e-12);
  // The narrow band is three voxels wide on either side, the padding one more.
  EXPECT_NEAR(x, 2 * (3.0 / 0.25 + 3) + 1, 2);

  const auto fog = telling_grid<vdb::FloatGrid>();
  fog->setGridClass(vdb::GRID_FOG_VOLUME);
  EXPECT_EQ(read(vdb_bytes({fog})).natural_side, Side::above);
}

TEST(OpenVdb, KeepsTilesAndTheirValues) {
  const auto grid = make_grid<vdb::FloatGrid>(0.5F);
  grid->fill(vdb::CoordBBox({0, 0, 0}, {15, 15, 15}), 2.0F, true);   // active tiles
  grid->fill(vdb::CoordBBox({16, 0, 0}, {23, 7, 7}), -1.0F, false);  // an inactive one beside them
  const Volume volume = read(vdb_bytes({grid}));
  EXPECT_EQ(volume.grid.dims, (std::array{18, 18, 18}));
  EXPECT_EQ(value_at(volume, 1, 1, 1), 2);
  EXPECT_EQ(value_at(volume, 16, 16, 16), 2);
  EXPECT_EQ(value_at(volume, 17, 1, 1), -1);
  EXPECT_EQ(value_at(volume, 17, 17, 17), 0.5);
  EXPECT_EQ(value_at(volume, 0, 0, 0), 0.5);
}

TEST(OpenVdb, PlacesTheGridByItsTransform) {
  const auto grid = telling_grid<vdb::FloatGrid>();
  // Row vectors: i goes to y, j against x, k to z; then a move.
  grid->setTransform(vdb::math::Transform::createLinearTransform(
      vdb::math::Mat4d(0, 2, 0, 0, -3, 0, 0, 0, 0, 0, 4, 0, 10, 20, 30, 1)));
  const Volume volume = read(vdb_bytes({grid}));
  expect_step(volume, 0, {0, 2, 0});
  expect_step(volume, 1, {-3, 0, 0});
  expect_step(volume, 2, {0, 0, 4});
  expect_near(volume.grid.origin, {10 + 9, 20 + 0, 30 + 8}, 1e-12);  // of voxel (0, -3, 2)

  grid->setTransform(vdb::math::Transform::createLinearTransform(
      vdb::math::Mat4d(1., .1, 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.)));
  refuse(vdb_bytes({grid}), ErrorCode::unusable);
  // OpenVDB does not make a singular map, so one is made of the bytes of another.
  grid->setTransform(vdb::math::Transform::createLinearTransform(
      vdb::math::Mat4d(1., 7.25, 0., 0., -7.25, 1., 0., 0., 0., 0., 3.5, 0., 0., 0., 0., 1.)));
  std::string singular = vdb_bytes({grid});
  singular.replace(singular.find(bytes_of(3.5, false)), 8, bytes_of(0.0, false));
  refuse(singular, ErrorCode::unusable);
  grid->setTransform(vdb::math::Transform::createFrustumTransform(vdb::BBoxd({0, 0, 0}, {20, 20, 20}), 0.5, 10.0));
  refuse(vdb_bytes({grid}), ErrorCode::unusable);
}

TEST(OpenVdb, ChoosesTheGridByNameElseTheFirstScalarOne) {
  const auto vectors = make_grid<vdb::Vec3SGrid>();
  vectors->setName("velocity");
  vectors->tree().setValue({0, 0, 0}, vdb::Vec3s(1, 2, 3));
  const auto one = make_grid<vdb::FloatGrid>();
  one->setName("one");
  one->tree().setValue({0, 0, 0}, 1);
  const auto two = make_grid<vdb::Int32Grid>();
  two->setName("two");
  two->tree().setValue({0, 0, 0}, 2);
  two->insertMeta("note", vdb::StringMetadata("doe"));
  vdb::GridBase& base = *one;
  const std::string bytes = vdb_bytes({vectors, one, two});
  EXPECT_EQ(value_at(read(bytes), 1, 1, 1), 1);
  EXPECT_EQ(value_at(read(bytes, {.grid = "two"}), 1, 1, 1), 2);
  refuse(bytes, ErrorCode::not_found, {.grid = "three"});
  refuse(bytes, ErrorCode::unusable, {.grid = "velocity"});
  refuse(vdb_bytes({vectors}), ErrorCode::unusable);
  refuse(vdb_bytes({}), ErrorCode::unusable);
  // Equal names are told apart by the file; the first is meant.
  EXPECT_EQ(value_at(read(vdb_bytes({one, base.deepCopyGrid()}), {.grid = "one"}), 1, 1, 1), 1);
}

std::string stream_bytes(const vdb::GridCPtrVec& grids, std::uint32_t compression = vdb::io::COMPRESS_ACTIVE_MASK) {
  vdb::initialize();
  std::ostringstream out;
  vdb::io::Stream stream(out);
  stream.setCompression(compression);
  stream.write(grids);
  return out.str();
}

// Several grids that share one tree, each with a place of its own; in files with and without the places of their grids.
TEST(OpenVdb, ReadsInstancesOfATree) {
  const auto one = telling_grid<vdb::FloatGrid>("one");
  vdb::GridBase& base = *one;
  const auto moved = base.copyGrid();  // shares the tree
  moved->setName("moved");
  moved->setTransform(vdb::math::Transform::createLinearTransform(2));
  moved->setGridClass(vdb::GRID_LEVEL_SET);
  for (const std::string& bytes : {vdb_bytes({one, moved}), stream_bytes({one, moved})}) {
    const Volume original = read(bytes), instance = read(bytes, {.grid = "moved"});
    expect_telling<vdb::FloatGrid, float>(original, *one);
    EXPECT_EQ(instance.voxels, original.voxels);
    expect_near(instance.grid.spacing, {2, 2, 2}, 1e-12);
    EXPECT_EQ(instance.natural_side, Side::below);
    EXPECT_EQ(original.natural_side, Side::above);
  }
}

// Written as a stream, a file does not say where its grids are: each is passed over to find the next.
TEST(OpenVdb, ReadsFilesWrittenAsAStream) {
  const auto vectors = make_grid<vdb::Vec3SGrid>();
  vectors->setName("velocity");
  for (int i = 0; i < 30; ++i) vectors->tree().setValue({i, 2 * i, 0}, vdb::Vec3s(float(i), 2, 3));
  const auto halved = telling_grid<vdb::FloatGrid>("half");
  halved->setSaveFloatAsHalf(true);
  const auto bits = telling_grid<vdb::BoolGrid>("bits");
  const auto last = telling_grid<vdb::Int64Grid>("last");
  for (const std::uint32_t compression : kCompressions) {
    for (const bool half_vectors : {false, true}) {
      vectors->setSaveFloatAsHalf(half_vectors);
      const std::string bytes = stream_bytes({vectors, halved, bits, last}, compression);
      expect_telling<vdb::FloatGrid, float>(read(bytes), *halved);
      expect_telling<vdb::BoolGrid, std::uint8_t>(read(bytes, {.grid = "bits"}), *bits);
      expect_telling<vdb::Int64Grid, std::int64_t>(read(bytes, {.grid = "last"}), *last);
    }
  }
  // What follows points, which we do not pass over, is not found.
  const auto points = vdb::points::PointDataGrid::create();
  points->setName("points");
  const std::string bytes = stream_bytes({halved, points, last});
  expect_telling<vdb::FloatGrid, float>(read(bytes), *halved);
  refuse(bytes, ErrorCode::not_found, {.grid = "last"});
}

TEST(OpenVdb, ReadsMasks) {
  const auto mask = make_grid<vdb::MaskGrid>();
  mask->tree().setValueOn({3, 4, 5});
  mask->tree().addTile(1, {8, 0, 0}, true, true);
  for (const std::uint32_t compression : kCompressions) {
    const Volume volume = read(vdb_bytes({mask}, compression));
    EXPECT_EQ(volume.type, VoxelType::uint8);
    ASSERT_EQ(volume.grid.dims, (std::array{15, 10, 10}));  // from (3, 0, 0) to (15, 7, 7)
    EXPECT_EQ(value_at(volume, 1, 5, 6), 1);
    EXPECT_EQ(value_at(volume, 2, 5, 6), 0);
    EXPECT_EQ(value_at(volume, 6, 1, 1), 1);
    EXPECT_EQ(value_at(volume, 14, 9, 9), 0);
  }
}

TEST(OpenVdb, TakesTheFirstGridWithActiveVoxelsAndListsAll) {
  const auto empty = make_grid<vdb::FloatGrid>();
  empty->setName("empty");
  const auto full = telling_grid<vdb::FloatGrid>("full");
  const auto odd = telling_grid<vdb::Int32Grid>("odd name/1");
  const auto velocity = make_grid<vdb::Vec3SGrid>();
  velocity->setName("velocity");
  const std::string bytes = vdb_bytes({empty, velocity, full, odd});
  const Volume volume = read(bytes);
  expect_telling<vdb::FloatGrid, float>(volume, *full);
  EXPECT_TRUE(warns(volume, "empty (float), velocity (vec3s), full (float), grid 4 (int32); number 3 was read"));
  EXPECT_TRUE(warns(volume, "the first one with active voxels"));
  EXPECT_TRUE(warns(read(bytes, {.grid = "odd name/1"}), "number 4 was read."));
  EXPECT_FALSE(warns(read(vdb_bytes({full})), "grids"));
  const TempFolder folder;
  const auto file = folder.add("doe.vdb", bytes);
  for (const char* name : {"none", "empty", "velocity"}) {
    try {
      read_volume({file}, {.grid = name});
      ADD_FAILURE();
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find("empty (float), velocity (vec3s), full (float)"), std::string::npos);
    }
  }
}

// A few voxels far apart make a box that no memory should be taken for.
TEST(OpenVdb, RefusesBoxesOutOfProportion) {
  const auto grid = make_grid<vdb::FloatGrid>();
  for (int i = 0; i < 8; ++i) {
    for (int j = 0; j < 8; ++j) grid->tree().setValue({100 * i, 100 * j, 50 * (i + j)}, 1);
  }
  const std::string bytes = vdb_bytes({grid});
  refuse(bytes, ErrorCode::too_large);
  const auto small = make_grid<vdb::BoolGrid>();
  small->tree().setValueOn({0, 0, 0}, true);
  small->tree().setValueOn({397, 397, 297}, true);
  EXPECT_EQ(read(vdb_bytes({small})).grid.dims, (std::array{400, 400, 300})) << "its memory is bounded";
}

// Bytes changed at random, several at a time: an Error or a volume, never anything else.
TEST(OpenVdb, AnswersMutatedFilesWithAnErrorOrAVolume) {
  const auto level_set = vdb::tools::createLevelSetSphere<vdb::FloatGrid>(3.0F, {1, 2, 3}, 1.0F, 2.0F);
  const auto bits = telling_grid<vdb::BoolGrid>("bits");
  vdb::GridBase& base = *level_set;
  const auto shared = base.copyGrid();
  const vdb::GridCPtrVec grids{level_set, bits, shared};
  const TempFolder folder;
  const ReadOptions options{.limits = {.max_voxels = 1 << 22, .max_bytes = std::size_t{1} << 24}};
  std::mt19937 random(14);
  std::size_t refused = 0;
  for (const std::uint32_t compression : kCompressions) {
    for (const bool as_stream : {false, true}) {
      const std::string bytes = as_stream ? stream_bytes(grids, compression) : vdb_bytes(grids, compression);
      for (int n = 0; n < 200; ++n) {
        std::string mutated = bytes;
        for (unsigned m = 0; m <= random() % 4; ++m) {
          // Half of them near the start, where sizes, names and the transform are.
          const std::size_t at = 12 + random() % (n % 2 == 0 ? 1200 : bytes.size() - 12);
          mutated[at] = static_cast<char>(random() % 3 == 0 ? 0xff : random());
        }
        try {
          read_volume({folder.add("doe.vdb", mutated)}, options);
        } catch (const Error& error) {
          ++refused;
          EXPECT_TRUE(std::string(error.what()).ends_with('.'));
        }
      }
    }
  }
  EXPECT_GT(refused, 200U);
}

TEST(OpenVdb, RefusesEmptyHugeAndFramedGrids) {
  refuse(vdb_bytes({make_grid<vdb::FloatGrid>()}), ErrorCode::unusable);
  const auto wide = make_grid<vdb::FloatGrid>();
  wide->tree().setValue({-2000000, 0, 0}, 1);
  wide->tree().setValue({2000000, 2000000, 2000000}, 1);
  refuse(vdb_bytes({wide}), ErrorCode::too_large);
  const auto tile = make_grid<vdb::FloatGrid>();
  tile->tree().addTile(3, {0, 0, 0}, 1, true);  // 4096³ in one value
  refuse(vdb_bytes({tile}), ErrorCode::too_large);
  const auto end = make_grid<vdb::FloatGrid>();
  end->tree().setValue({INT32_MAX, 0, 0}, 1);
  refuse(vdb_bytes({end}), ErrorCode::unusable);
  const std::string bytes = vdb_bytes({telling_grid<vdb::FloatGrid>()});
  refuse(bytes, ErrorCode::too_large, {.limits = {.max_voxels = 1319}});
  EXPECT_NO_THROW(read(bytes, {.limits = {.max_voxels = 8 * 512}}));
  refuse(bytes, ErrorCode::invalid_argument, {.frame = 1});
}

TEST(OpenVdb, RefusesOtherVersions) {
  std::string bytes = vdb_bytes({telling_grid<vdb::FloatGrid>()});
  for (const std::uint32_t version : {0U, 200U, 221U, 225U, UINT32_MAX}) {
    bytes.replace(8, 4, bytes_of(version, false));
    refuse(bytes, ErrorCode::unusable);
  }
}

TEST(OpenVdb, RefusesCutFiles) {
  for (const std::uint32_t compression : kCompressions) {
    const std::string bytes = vdb_bytes({telling_grid<vdb::FloatGrid>()}, compression);
    for (std::size_t size = 12; size < bytes.size(); size += 1 + bytes.size() / 200) {
      const TempFolder folder;
      expect_refused({folder.add("doe.vdb", bytes.substr(0, size))}, ErrorCode::malformed);
    }
  }
}

// Found by fuzzing: a length before packed values that claims far more than the node has room for, in a file that
// really goes on for so long. OpenVDB alone would write all of it over whatever lies behind the node.
TEST(OpenVdb, RefusesMoreValuesThanANodeHasRoomFor) {
  for (const bool half : {false, true}) {
    for (const std::uint32_t compression : kCompressions) {
      if (compression == vdb::io::COMPRESS_NONE) continue;
      const auto grid = telling_grid<vdb::FloatGrid>();
      grid->setSaveFloatAsHalf(half);
      const std::string bytes = vdb_bytes({grid}, compression);
      constexpr std::size_t kMore = std::size_t{1} << 20;
      const TempFolder folder;
      const auto file = folder.add("doe.vdb", bytes + std::string(2 * kMore, '\1'));
      std::size_t lengths = 0;
      // Whatever may be such a length, which is negated where the values are not packed after all.
      for (std::size_t at = 8; at + 8 < bytes.size(); ++at) {
        std::int64_t length = 0;
        std::memcpy(&length, &bytes[at], sizeof length);
        if (length == 0 || std::abs(length) > 4096) continue;
        for (const std::int64_t lie : {-static_cast<std::int64_t>(kMore), static_cast<std::int64_t>(kMore)}) {
          const auto put = [&](std::int64_t v) {
            std::fstream(file, std::ios::binary | std::ios::in | std::ios::out)
                .seekp(static_cast<long>(at))
                .write(reinterpret_cast<const char*>(&v), sizeof v);
          };
          put(lie);
          try {
            read_volume({file});
          } catch (const Error& error) {
            lengths += error.code() == ErrorCode::malformed;
          }
          put(length);
        }
      }
      EXPECT_GE(lengths, 2U) << "at least one leaf";
    }
  }
}

// A small file damaged in one place after another: whatever comes of it, it is an Error or a volume, and nothing is
// lost on the way (a tree that is lost when its reading fails adds up to gigabytes here).
TEST(OpenVdb, SurvivesDamageAnywhereWithoutLosingMemory) {
  const auto level_set = vdb::tools::createLevelSetSphere<vdb::FloatGrid>(3.0F, {1, 2, 3}, 1.0F, 2.0F);
  for (const std::uint32_t compression : kCompressions) {
    const std::string bytes = vdb_bytes({level_set}, compression);
    const TempFolder folder;
    const auto file = folder.add("doe.vdb", bytes);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      const ReadOptions options{.limits = {.max_bytes = std::size_t{1} << 24}};
      rusage before{}, after{};
      getrusage(RUSAGE_SELF, &before);
      // Densely through the headers and the topology's start, sparsely through the rest.
      for (std::size_t at = 8; at < bytes.size(); at += at < 800 ? 2 : 1 + bytes.size() / 200) {
        for (const int damage : {0x80, 0xff}) {
          const auto put = [&](char byte) {
            std::fstream(file, std::ios::binary | std::ios::in | std::ios::out).seekp(static_cast<long>(at)).put(byte);
          };
          put(static_cast<char>(bytes[at] ^ damage));
          try {
            read_volume({file}, options);
          } catch (const Error&) {
          }
          put(bytes[at]);
        }
      }
      getrusage(RUSAGE_SELF, &after);
      _exit(after.ru_maxrss - before.ru_maxrss > 100 * 1024 ? 2 : 0);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFEXITED(status)) << "signal " << WTERMSIG(status);
    EXPECT_EQ(WEXITSTATUS(status), 0) << "lost memory";
  }
}

}  // namespace
}  // namespace spherule::test
