// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every kind of picture hears a cancel within 100 ms: of processor time, so that a busy machine does not matter.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <ctime>
#include <thread>

#include "core/base/error.h"
#include "core/render/plot.h"
#include "core/render/render.h"
#include "core/render/slice_picture.h"
#include "tests/core/render/scenes.h"

namespace spherule {
namespace {

double processor_seconds(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

constexpr double kSoon = 0.1;

// Asks `work` to stop once it has used `after` s of its thread's processor time; how much more it then used. Work that
// ends by itself before that is no test of this.
template <typename Work>
double seconds_to_stop_once(double after, Work& work) {
  std::stop_source stop;
  std::atomic<double> asked = 0;
  clockid_t clock{};
  pthread_getcpuclockid(pthread_self(), &clock);
  const double begin = processor_seconds(clock);
  bool cancelled = false;
  {
    const std::jthread watch([&, clock](const std::stop_token& over) {
      while (!over.stop_requested() && processor_seconds(clock) - begin < after) std::this_thread::yield();
      stop.request_stop();
      asked = processor_seconds(clock);
    });
    try {
      work(Context{.threads = 1, .cancel = stop.get_token(), .progress = {}});
    } catch (const Error& error) {
      cancelled = error.code() == ErrorCode::cancelled;
    }
  }
  EXPECT_TRUE(cancelled);
  return processor_seconds(clock) - asked;
}

// The least of up to three tries: what hears late does so each time; a machine that is busy with other work, or slow to
// take memory back, does not.
template <typename Work>
double seconds_to_stop(double after, Work&& work) {
  double least = seconds_to_stop_once(after, work);
  for (int again = 0; again < 2 && least >= kSoon; ++again) least = std::min(least, seconds_to_stop_once(after, work));
  return least;
}

// A row of overlapping balls, along which a ray meets all.
SphereModel row_of_balls(int n) {
  SphereModel model;
  for (int i = 0; i < n; ++i) model.spheres.push_back({{0.5 * i, 0, 0}, 1});
  return model;
}

// n³ overlapping balls, which fill a picture.
SphereModel block_of_balls(int n) {
  SphereModel model;
  for (int k = 0; k < n; ++k)
    for (int j = 0; j < n; ++j)
      for (int i = 0; i < n; ++i) model.spheres.push_back({{1.0 * i, 1.0 * j, 1.0 * k}, 1});
  return model;
}

TEST(Cancel, IsHeardByRays) {
  const SphereModel row = row_of_balls(20'000), block = block_of_balls(27);
  for (const Style style : {Style::spheres, Style::blobs, Style::centres})
    for (const View view : {View::anterior, View::right}) {
      // The memory of a larger picture alone takes the system nearly as long as a cancel may, after blobs' cells.
      const int side = style == Style::blobs ? 2000 : 4000;
      const RenderOptions options{
          .width = side, .height = side, .samples_per_axis = 8, .style = style, .views = {view}};
      const Subject subject{.model = style == Style::spheres ? &row : &block};
      for (const double after : {0.01, 0.3})
        EXPECT_LT(seconds_to_stop(after, [&](const Context& c) { render(std::span(&subject, 1), options, c); }), kSoon)
            << static_cast<int>(style) << static_cast<char>(view) << after;
    }
}

TEST(Cancel, IsHeardByPainters) {
  Drawing drawing(5000, 5000);
  std::vector<std::vector<Point2>> lines, areas;
  std::vector<Drawing::Ring> rings;
  for (int i = 0; i < 20'000; ++i) {
    const double at = 0.25 * i;
    lines.push_back({{at, 0}, {5000 - at, 5000}});
    areas.push_back({{0, at}, {5000, at}, {2500, at + 4000}});
    rings.push_back({{2500, 2500}, at});
  }
  drawing.lines(lines, 2, {});
  Drawing filled(5000, 5000), round(5000, 5000);
  filled.areas(areas, {});
  round.circles(rings, 2, {});
  Image image = blank_image(5000, 5000);
  for (const Drawing* d : {&drawing, &filled, &round})
    EXPECT_LT(seconds_to_stop(0.3, [&](const Context& c) { paint(*d, image, c); }), kSoon);
  for (int i = 0; i < 100; ++i) drawing.add(filled, 0, 0);
  EXPECT_LT(seconds_to_stop(0.1, [&](const Context& c) { to_svg(drawing, {}, c); }), kSoon);
}

TEST(Cancel, IsHeardByWritersOfFiles) {
  Image image = blank_image(6000, 4000);
  std::uint32_t noise = 1;
  for (std::uint8_t& byte : image.rgba) byte = static_cast<std::uint8_t>((noise = noise * 1664525 + 1013904223) >> 24);
  EXPECT_LT(seconds_to_stop(0.2, [&](const Context& c) { encode_png(image, c); }), kSoon);
  Image small = blank_image(200, 200);
  std::copy_n(image.rgba.begin(), small.rgba.size(), small.rgba.begin());
  const std::vector<Image> frames(200, small);
  EXPECT_LT(seconds_to_stop(0.2, [&](const Context& c) { encode_gif(frames, 10, c); }), kSoon);
}

TEST(Cancel, IsHeardBySlices) {
  Volume slice;
  slice.grid.dims = {2000, 2000, 1};
  slice.voxels.resize(slice.grid.sample_count());
  const SliceOptions options{.width = 8192, .height = 8192, .show = {}};
  EXPECT_LT(seconds_to_stop(0.3,
                            [&](const Context& c) {
                              draw_slice(slice, 2, 0, nullptr, {1, 0}, options, c);
                            }),
            kSoon);
}

}  // namespace
}  // namespace spherule
