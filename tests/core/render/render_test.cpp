// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/render.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>

#include <numbers>

#include "core/base/error.h"
#include "tests/core/render/scenes.h"

namespace spherule {
namespace {

SphereModel of(std::vector<Sphere> spheres) {
  SphereModel model;
  model.spheres = std::move(spheres);
  return model;
}

const std::uint8_t* at(const Image& image, int x, int y) {
  return &image.rgba[4 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) +
                          static_cast<std::size_t>(x))];
}

// Covered area in pixels and its centroid, from alpha, within [x0, x1) × [y0, y1).
struct Coverage {
  double area = 0, x = 0, y = 0;
};
Coverage coverage(const Image& image, int x0, int y0, int x1, int y1) {
  Coverage c;
  for (int y = y0; y < y1; ++y)
    for (int x = x0; x < x1; ++x) {
      const double alpha = at(image, x, y)[3] / 255.0;
      c.area += alpha, c.x += alpha * (x + 0.5), c.y += alpha * (y + 0.5);
    }
  return {c.area, c.x / c.area, c.y / c.area};
}
Coverage coverage(const Image& image) { return coverage(image, 0, 0, image.width, image.height); }

double brightness(const Image& image, int x, int y) {
  return at(image, x, y)[0] + at(image, x, y)[1] + at(image, x, y)[2];
}

template <typename F>
void expect_error(F&& f, ErrorCode code) {
  try {
    f();
    ADD_FAILURE() << "nothing was thrown";
  } catch (const Error& e) {
    EXPECT_EQ(static_cast<int>(e.code()), static_cast<int>(code)) << e.what();
  }
}

TEST(Render, SilhouetteOfABallIsItsDisc) {
  const double radius = 7.5;
  const Sphere ball{{100, -30, 12}, radius};
  Box box;
  box.include(ball);
  for (const auto& [width, height] : {std::pair{200, 200}, std::pair{300, 160}}) {
    const RenderOptions options{.width = width, .height = height, .view = View::left, .samples_per_axis = 4};
    const Image image = render_spheres(of({ball}), options);
    ASSERT_EQ(image.width, width);
    ASSERT_EQ(image.height, height);
    const double pixel = fit_camera(box, options).mm_per_pixel;
    EXPECT_NEAR(pixel, 2 * radius / (0.92 * height), 1e-12);
    const Coverage c = coverage(image);
    EXPECT_NEAR(c.area * pixel * pixel / (std::numbers::pi * radius * radius), 1, 5e-4);
    EXPECT_NEAR(c.x, width / 2.0, 0.01);
    EXPECT_NEAR(c.y, height / 2.0, 0.01);
  }
}

TEST(Render, CamerasAreNeverMirrored) {
  Box box;
  box.include(Sphere{{0, 0, 0}, 1});
  for (const char letter : {'a', 'p', 'r', 'l', 'h', 'f'}) {
    const Camera camera = fit_camera(box, {.view = static_cast<View>(letter)});
    EXPECT_EQ(cross(camera.right, camera.up), -camera.forward) << letter;
  }
}

TEST(Render, ViewsPutTheMarkerWhereTheTableSays) {
  // Towards: x left, y posterior, z head.
  const Vec3 left{1, 0, 0}, right{-1, 0, 0}, posterior{0, 1, 0}, anterior{0, -1, 0}, head{0, 0, 1};
  const std::vector<std::tuple<char, Vec3, Vec3>> table{{'a', left, head},      {'p', right, head},
                                                        {'r', anterior, head},  {'l', posterior, head},
                                                        {'h', right, anterior}, {'f', left, anterior}};
  for (const auto& [letter, picture_right, picture_up] : table) {
    const RenderOptions options{.width = 60, .height = 60, .view = static_cast<View>(letter), .samples_per_axis = 2};
    const Vec3 centre{40, -20, 7};
    // A small ball beside a large one: the smaller covered half is the marker's.
    const Image beside = render_spheres(of({{centre, 10}, {centre + 30 * picture_right, 2}}), options);
    const double at_left = coverage(beside, 0, 0, 30, 60).area, at_right = coverage(beside, 30, 0, 60, 60).area;
    EXPECT_GT(at_right, 0) << letter;
    EXPECT_LT(at_right, at_left) << letter;
    const Image above = render_spheres(of({{centre, 10}, {centre + 30 * picture_up, 2}}), options);
    const double at_top = coverage(above, 0, 0, 60, 30).area, at_bottom = coverage(above, 0, 30, 60, 60).area;
    EXPECT_GT(at_top, 0) << letter;
    EXPECT_LT(at_top, at_bottom) << letter;
  }
}

TEST(Render, KeyLightComesFromTheUpperLeft) {
  const Image image = render_spheres(of({{{0, 0, 0}, 10}}), {.width = 100, .height = 100});
  const double upper_left = brightness(image, 32, 30), upper_right = brightness(image, 70, 30);
  const double lower_left = brightness(image, 30, 70), lower_right = brightness(image, 70, 70);
  EXPECT_GT(upper_left, upper_right);
  EXPECT_GT(upper_left, lower_left);
  EXPECT_GT(upper_right, lower_right);
  EXPECT_GT(lower_left, lower_right);
}

TEST(Render, NearBallHidesFarOneAndShadesIt) {
  // Seen from the front, the second ball is behind the first and a little below: in its shadow.
  const RenderOptions options{.width = 100, .height = 100, .samples_per_axis = 2};
  const Sphere front{{0, -40, 0}, 10}, wall{{0, 1020, 0}, 1000};
  const Image alone = render_spheres(of({wall}), options);
  const Image both = render_spheres(of({wall, front}), options);
  // The wall fills the picture's middle alike; the shadow of the small ball falls to the lower right of it.
  int darker = 0, right_of_middle = 0;
  for (int y = 10; y < 90; ++y)
    for (int x = 10; x < 90; ++x)
      if (brightness(both, x, y) < brightness(alone, x, y) - 60) ++darker, right_of_middle += x > 50 && y > 50;
  EXPECT_GT(darker, 0);
  EXPECT_GT(2 * right_of_middle, darker);
}

TEST(Render, HiddenBallsChangeNothing) {
  const SphereModel raw = raw_model();
  SphereModel balls = raw;
  balls.solid.reset();
  for (const View view : {View::anterior, View::head}) {
    const RenderOptions options{.width = 150, .height = 120, .view = view, .samples_per_axis = 2};
    const Image filtered = render_spheres(raw, options), all = render_spheres(balls, options);
    std::size_t different = 0;
    for (std::size_t i = 0; i < all.rgba.size(); ++i) {
      const int difference = std::abs(filtered.rgba[i] - all.rgba[i]);
      different += difference > 0;
      // Where balls meet, a rounding decides which one a ray meets first: one sample of four may differ.
      ASSERT_LE(difference, 64);
    }
    EXPECT_LE(different, all.rgba.size() / 1000);
  }
}

TEST(Render, IsTheSameForEveryThreadCount) {
  const SphereModel model = random_balls(500, 2);
  const RenderOptions options{.width = 97, .height = 70, .samples_per_axis = 2};
  const Image one = render_spheres(model, options);
  for (const unsigned threads : {2U, 5U}) {
    Context context;
    context.threads = threads;
    EXPECT_EQ(render_spheres(model, options, context).rgba, one.rgba);
  }
}

TEST(Render, Backgrounds) {
  const SphereModel ball = of({{{0, 0, 0}, 1}});
  RenderOptions options{.width = 40, .height = 40};
  const Image clear = render_spheres(ball, options);
  EXPECT_EQ(at(clear, 0, 0)[3], 0);
  EXPECT_EQ(at(clear, 20, 20)[3], 255);
  options.background = Background::white;
  const Image white = render_spheres(ball, options);
  for (int a = 0; a < 4; ++a) EXPECT_EQ(at(white, 0, 0)[a], 255);
  for (int a = 0; a < 4; ++a) EXPECT_EQ(at(white, 20, 20)[a], at(clear, 20, 20)[a]);
  options.background = Background::dark;
  const Image dark = render_spheres(ball, options);
  EXPECT_LT(at(dark, 0, 0)[0], 50);
  EXPECT_EQ(at(dark, 0, 0)[3], 255);
}

TEST(Render, SmallestPictureAndFlatSets) {
  const Image dot = render_spheres(of({{{0, 0, 0}, 1}}), {.width = 1, .height = 1});
  EXPECT_GT(dot.rgba[3], 128);
  // Balls on one line, seen along it and across it; and a ball so small that it falls between rays.
  const SphereModel line = of({{{0, 0, 0}, 20}, {{0, 500, 0}, 20}, {{0, 250, 0}, 1e-6}});
  for (const View view : {View::anterior, View::left})
    EXPECT_GT(coverage(render_spheres(line, {.width = 64, .height = 16, .view = view})).area, 0);
}

TEST(Render, FarApartBallsAreFittedToo) {
  const SphereModel model = of({{{-1e9, 0, 0}, 1e8}, {{1e9, 0, 0}, 1e8}});
  const Image image = render_spheres(model, {.width = 200, .height = 50});
  EXPECT_NEAR(coverage(image).x, 100, 0.5);
}

TEST(Render, RefusesWhatItCannotDraw) {
  const SphereModel ball = of({{{0, 0, 0}, 1}});
  for (const RenderOptions& options :
       {RenderOptions{.width = 0}, RenderOptions{.width = 8193}, RenderOptions{.height = -5},
        RenderOptions{.height = 8193}, RenderOptions{.samples_per_axis = 0}, RenderOptions{.samples_per_axis = 9}})
    expect_error([&] { render_spheres(ball, options); }, ErrorCode::invalid_argument);
  expect_error([] { render_spheres({}); }, ErrorCode::unusable);
  expect_error([] { render_spheres(of({{{1, 2, 3}, 0}})); }, ErrorCode::unusable);
}

TEST(Render, ReportsProgressAndStopsWhenAsked) {
  std::stop_source source;
  double last = 0;
  Context context;
  context.cancel = source.get_token();
  context.progress = [&](std::string_view stage, double fraction) {
    if (stage != "render") return;
    EXPECT_GE(fraction, last);
    last = fraction;
    if (fraction > 0.3) source.request_stop();
  };
  expect_error([&] { render_spheres(random_balls(50, 2), {.width = 256, .height = 256}, context); },
               ErrorCode::cancelled);
  EXPECT_GT(last, 0.3);
  EXPECT_LT(last, 1);
}

TEST(Png, HoldsTheSamePixelsAndIsTheSameEachTime) {
  const Image image = render_spheres(random_balls(50, 3), {.width = 61, .height = 43});
  const std::string bytes = encode_png(image);
  EXPECT_EQ(encode_png(image), bytes);
  EXPECT_EQ(bytes.find("tIME"), std::string::npos);
  EXPECT_NE(bytes.find("sRGB"), std::string::npos);

  OIIO::Filesystem::IOMemReader memory(bytes.data(), bytes.size());
  const auto input = OIIO::ImageInput::create("png");
  ASSERT_TRUE(input && input->set_ioproxy(&memory));
  OIIO::ImageSpec keep, found;
  keep.attribute("oiio:UnassociatedAlpha", 1);
  ASSERT_TRUE(input->open("memory.png", found, keep)) << input->geterror();
  ASSERT_EQ(found.width, 61);
  ASSERT_EQ(found.height, 43);
  ASSERT_EQ(found.nchannels, 4);
  std::vector<std::uint8_t> pixels(image.rgba.size());
  ASSERT_TRUE(input->read_image(0, 0, 0, 4, OIIO::TypeDesc::UINT8, pixels.data()));
  EXPECT_EQ(pixels, image.rgba);
}

}  // namespace
}  // namespace spherule
