// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/plot.h"

#include <gtest/gtest.h>

namespace spherule {
namespace {

Image painted(const Plot& plot, int width, int height) {
  Image image = blank_image(width, height);
  paint(draw_plot(plot, width, height), image);
  return image;
}

// The bars' blue.
bool is_bar(const Image& image, int x, int y) { return image.at(x, y)[0] < 80 && image.at(x, y)[2] > 140; }

// Rows of a bar in a column of pixels.
int bar_height(const Image& image, int x) {
  int rows = 0;
  for (int y = 0; y < image.height; ++y) rows += is_bar(image, x, y);
  return rows;
}

// The first and the last column with a bar.
std::array<int, 2> extent(const Image& image) {
  std::array<int, 2> ends{-1, -1};
  for (int x = 0; x < image.width; ++x)
    if (bar_height(image, x) > 0) ends = {ends[0] < 0 ? x : ends[0], x};
  return ends;
}

TEST(Plot, BarsAreAsHighAsTheirNumbers) {
  const Plot plot{.title = "t", .x = {"x"}, .y = {"y"}, .heights = {10, 5, 0, 20}};
  const Image image = painted(plot, 800, 600);
  const auto [left, right] = extent(image);
  const double step = (right + 1 - left) / 4.0;
  const auto height = [&](int i) { return bar_height(image, static_cast<int>(left + (i + 0.5) * step)); };
  EXPECT_GT(height(3), 400);
  EXPECT_NEAR(height(0), height(3) / 2.0, 1.5);
  EXPECT_NEAR(height(1), height(3) / 4.0, 1.5);
  EXPECT_EQ(height(2), 0);
}

TEST(Plot, EqualRatiosAreEqualStepsOnALogarithmicAxis) {
  Plot plot{.title = "t", .x = {"x"}, .y = {"y", {}, true}, .heights = {1, 10, 100, 0}};
  const Image image = painted(plot, 800, 600);
  const auto [left, right] = extent(image);
  const double step = (right + 1 - left) / 3.0;
  const auto height = [&](int i) { return bar_height(image, static_cast<int>(left + (i + 0.5) * step)); };
  EXPECT_GT(height(0), 20) << "one is to be seen";
  EXPECT_NEAR(height(2) - height(1), height(1) - height(0), 2);
}

TEST(Plot, SaysWhatItShows) {
  Plot plot{.title = "A title", .x = {"radius", "mm"}, .y = {"spheres"}, .lo = 0, .hi = 2000, .heights = {3, 4}};
  plot.marks = {{60.5}, {-1, "beyond"}, {1500, "here"}};
  const std::string svg = to_svg(draw_plot(plot, 900, 560));
  for (const char* word : {">A title<", ">radius (mm)<", ">spheres<", ">1,000<", ">2,000<", ">60.5<", ">here<"})
    EXPECT_NE(svg.find(word), std::string::npos) << word;
  EXPECT_EQ(svg.find("beyond"), std::string::npos);
}

TEST(Plot, OfThresholdsIsTheVolumeAboveThem) {
  const Plot plot = plot_of_thresholds({0, 100, 0}, {50, 30, 20}, 2);
  // Half of a step's voxels lie above its middle.
  EXPECT_EQ(plot.heights, (std::vector<double>{2 * (50 + 25), 2 * (20 + 15), 2 * 10}));
  EXPECT_EQ(plot.y.unit, "mm³");
  EXPECT_TRUE(plot.line);
}

TEST(Plot, DrawsWhatHasOneValueOrNone) {
  for (const Plot& plot :
       {plot_of_values({5, 5, 0}, {7}), plot_of_values({0, 0, 0}, {0}),
        plot_of_radii({.scale = RadiusScale::logarithmic, .min_mm = 0, .max_mm = 0, .counts = {0, 0}}),
        plot_of_radii({.scale = RadiusScale::logarithmic, .min_mm = 2, .max_mm = 2, .counts = {4}}),
        plot_of_thresholds({1, 1, 0}, {0, 0, 0, 9}, 1)})
    for (const int size : {1, 100, 700}) EXPECT_EQ(painted(plot, size, size).width, size);
}

TEST(Plot, PngIsThePaintedDrawing) {
  const Plot plot = plot_of_radii({.min_mm = 1, .max_mm = 3, .counts = {1, 2, 3}});
  EXPECT_EQ(plot_to_png(plot, 120, 100), encode_png(painted(plot, 120, 100)));
}

}  // namespace
}  // namespace spherule
