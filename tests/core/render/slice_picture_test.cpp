// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/slice_picture.h"

#include <gtest/gtest.h>

#include <numbers>

#include "tests/phantoms.h"

namespace spherule {
namespace {

using namespace phantoms;

Grid grid_of(std::array<std::int32_t, 3> dims, Vec3 spacing, Mat3 direction = {}) {
  Grid grid;
  grid.dims = dims;
  grid.spacing = spacing;
  grid.direction = direction;
  return grid;
}

SliceOptions bare(int width, int height) {
  return {.width = width, .height = height, .letters = false, .scale_bar = false, .caption = false};
}

Image painted(SlicePicture picture) {
  paint(picture.drawing, picture.image);
  return picture.image;
}

TEST(PlaneOf, ReadsAsARadiologistReads) {
  const Grid lps = grid_of({3, 3, 3}, {1, 1, 1});
  const auto plane = [&](const Grid& grid, int axis) {
    Volume volume;
    volume.grid = grid;
    volume.voxels.resize(grid.sample_count());
    return plane_of(slice_of(volume, axis, 1).grid);
  };
  const auto edges = [](const SlicePlane& p) { return p.left + " " + p.right + " " + p.top + " " + p.bottom; };
  EXPECT_EQ(plane(lps, 2).name, "axial");
  EXPECT_EQ(edges(plane(lps, 2)), "R L A P");
  EXPECT_EQ(plane(lps, 1).name, "coronal");
  EXPECT_EQ(edges(plane(lps, 1)), "R L H F");
  EXPECT_EQ(plane(lps, 0).name, "sagittal");
  EXPECT_EQ(edges(plane(lps, 0)), "A P H F");
  // Every way to turn and flip a grid shows the same.
  for (const std::array<int, 3>& order : {std::array{0, 1, 2}, {1, 0, 2}, {2, 1, 0}, {0, 2, 1}, {1, 2, 0}, {2, 0, 1}})
    for (int signs = 0; signs < 8; ++signs) {
      Mat3 direction{{Vec3{}, Vec3{}, Vec3{}}};
      for (int a = 0; a < 3; ++a)
        direction.rows[static_cast<std::size_t>(order[static_cast<std::size_t>(a)])][a] = signs >> a & 1 ? -1 : 1;
      const Grid turned = grid_of({3, 3, 3}, {1, 1, 1}, direction);
      for (int a = 0; a < 3; ++a)
        EXPECT_EQ(edges(plane(turned, a)), edges(plane(lps, order[static_cast<std::size_t>(a)])));
    }
  const double c = std::cos(0.5), s = std::sin(0.5);
  const SlicePlane oblique = plane(grid_of({3, 3, 3}, {1, 1, 1}, {{Vec3{1, 0, 0}, Vec3{0, c, -s}, Vec3{0, s, c}}}), 2);
  EXPECT_EQ(oblique.name, "oblique axial");
  EXPECT_EQ(edges(oblique), "R L AF PH");
}

TEST(SlicePicture, SamplesLieWhereTheirPlacesAre) {
  // x to the patient's right and y to the front: on the picture both run backwards.
  Volume slice = noise(grid_of({4, 2, 1}, {1, 3, 1}, {{Vec3{-1, 0, 0}, Vec3{0, -1, 0}, Vec3{0, 0, 1}}}), 1, 1);
  set_stored(slice, {0, 0, 0}, 100);
  SliceOptions options = bare(80, 120);
  options.smooth = false;
  const Image image = painted(draw_slice(slice, 2, 0, nullptr, {.width = 200, .level = 100}, options));
  // 4 x 1 mm by 2 x 3 mm: 20 pixels a mm, so 80 x 120, and sample (0, 0) is the last across and the last down.
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 80; ++x) ASSERT_EQ(image.at(x, y)[0], x >= 60 && y >= 60 ? 128 : 0) << x << ' ' << y;
}

TEST(SlicePicture, ValuesBetweenSamplesAreInterpolated) {
  Volume slice = noise(grid_of({2, 1, 1}, {1, 1, 1}), 1, 1);
  set_stored(slice, {1, 0, 0}, 200);
  const Image image = painted(draw_slice(slice, 2, 0, nullptr, {.width = 200, .level = 100}, bare(200, 100)));
  for (int x = 0; x < 200; ++x) {
    const double expected = 255 * std::clamp((x + 0.5 - 50) / 100, 0.0, 1.0);
    EXPECT_NEAR(image.at(x, 50)[0], expected, 0.51) << x;
  }
}

TEST(SlicePicture, WhatIsNoNumberIsLeftOut) {
  Volume slice = noise(grid_of({3, 1, 1}, {1, 1, 1}), 1, 1, VoxelType::float64);
  set_stored(slice, {0, 0, 0}, 50), set_stored(slice, {1, 0, 0}, NAN), set_stored(slice, {2, 0, 0}, 50);
  const Image image = painted(draw_slice(slice, 2, 0, nullptr, {.width = 100, .level = 50}, bare(300, 100)));
  EXPECT_EQ(image.at(10, 50)[0], 128);
  EXPECT_LT(image.at(150, 50)[0], 20) << "the ground shows";
}

TEST(SlicePicture, AWindowIsWhatRadiologyCallsSo) {
  Volume slice = noise(grid_of({5, 1, 1}, {1, 1, 1}), 1, 1, VoxelType::int16);
  for (int i = 0; i < 5; ++i) set_stored(slice, {i, 0, 0}, -1000 + 500 * i);
  SliceOptions options = bare(50, 10);
  options.smooth = false;
  const Image image = painted(draw_slice(slice, 2, 0, nullptr, {.width = 1000, .level = 0}, options));
  for (const auto& [x, grey] : {std::pair{5, 0}, {15, 0}, {25, 128}, {35, 255}, {45, 255}})
    EXPECT_EQ(image.at(x, 5)[0], grey);
}

TEST(SlicePicture, ADiscIsCoveredByItsInsideTriangles) {
  const double radius = 11.5 * (1 - 120.0 / 255);
  const Volume slice = slice_of(sample(paper_ball({0, 0, 0}), cubic_grid(25, 24)), 2, 12);
  const PlaneModel model = build_plane_model(slice, threshold(120));
  SliceOptions options = bare(500, 500);
  options.image = false;
  options.show = {Overlay::inside};
  const Image image = painted(draw_slice(slice, 2, 12, &model, {}, options));
  std::size_t covered = 0;
  for (int y = 0; y < 500; ++y)
    for (int x = 0; x < 500; ++x) {
      const double distance = std::hypot(x + 0.5 - 250, y + 0.5 - 250) / 20;  // 25 mm across 500 pixels
      const bool drawn = image.at(x, y)[0] < 250;
      covered += drawn;
      if (distance < radius - 0.2) {
        ASSERT_TRUE(drawn) << x << ' ' << y;
      }
      if (distance > radius + 0.15) {
        ASSERT_FALSE(drawn) << x << ' ' << y;
      }
    }
  EXPECT_NEAR(static_cast<double>(covered) / 400, std::numbers::pi * radius * radius, 3);
}

TEST(SlicePicture, EveryOverlayShowsAndRegionsZoom) {
  const Volume slice = slice_of(sample(paper_ball({0, 0, 0}), cubic_grid(25, 24)), 2, 12);
  const PlaneModel model = build_plane_model(slice, threshold(120));
  SliceOptions options = bare(200, 200);
  const Image without = painted(draw_slice(slice, 2, 12, nullptr, {255, 127}, options));
  std::vector<Image> seen{without};
  for (const Overlay what :
       {Overlay::contour, Overlay::points, Overlay::triangles, Overlay::inside, Overlay::circles, Overlay::centres}) {
    options.show = {what};
    Image image = painted(draw_slice(slice, 2, 12, &model, {255, 127}, options));
    for (const Image& other : seen) EXPECT_NE(image.rgba, other.rgba);
    seen.push_back(std::move(image));
  }
  // The contour crosses the picture's right half on its middle row once, where the radius says.
  options.show = {Overlay::contour};
  options.region = {12, 7, 22, 17};
  options.image = false;
  const Image zoomed = painted(draw_slice(slice, 2, 12, &model, {}, options));
  const double radius = 11.5 * (1 - 120.0 / 255);
  for (int x = 0; x < 200; ++x) {
    const double at = (x + 0.5) / 20;  // mm from the middle of the ball
    if (std::abs(at - radius) > 0.2) {
      EXPECT_EQ(zoomed.at(x, 100)[2], 255) << x;
    }
  }
  EXPECT_LT(zoomed.at(static_cast<int>(20 * radius), 100)[2], 200);
}

TEST(SlicePicture, NotesStandAroundTheSlice) {
  const Volume slice = noise(grid_of({10, 10, 1}, {1, 1, 1}), 1, 1);
  const SlicePicture picture = draw_slice(slice, 2, 3, nullptr, {100, 50}, {});
  const std::string svg = to_svg(picture.drawing);
  for (const char* word : {">R<", ">L<", ">A<", ">P<", ">axial, k = 3<", ">window 100, level 50<", ">2 mm<"})
    EXPECT_NE(svg.find(word), std::string::npos) << word;
}

TEST(SlicePicture, SmallestPictures) {
  const Volume slice = noise(grid_of({1, 1, 1}, {1, 1, 1}), 1, 1);
  const PlaneModel model = build_plane_model(slice, threshold(0));
  for (const int size : {1, 2, 30}) {
    SliceOptions options;
    options.width = size, options.height = 1;
    EXPECT_EQ(painted(draw_slice(slice, 2, 0, &model, {1, 0}, options)).rgba.size(),
              4 * static_cast<std::size_t>(size));
  }
}

TEST(UsualWindow, HoldsAllButTheExtremes) {
  Volume volume = noise(grid_of({100, 100, 1}, {1, 1, 1}), 1000, 5, VoxelType::int16);
  set_stored(volume, {0, 0, 0}, 30000);
  Window window = usual_window(volume);
  EXPECT_NEAR(window.level - window.width / 2, 5, 10);
  EXPECT_NEAR(window.level + window.width / 2, 995, 12);
  // A few bright samples on a ground: they are what there is to see.
  volume = noise(grid_of({100, 100, 1}, {1, 1, 1}), 1, 5, VoxelType::int16);
  set_stored(volume, {5, 5, 0}, 300);
  window = usual_window(volume);
  EXPECT_EQ(window, (Window{300, 150}));
  EXPECT_GT(usual_window(noise(grid_of({4, 4, 1}, {1, 1, 1}), 1, 5)).width, 0);
}

}  // namespace
}  // namespace spherule
