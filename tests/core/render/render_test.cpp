// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/render.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>

#include <numbers>

#include "core/base/error.h"
#include "core/compare/marching_cubes.h"
#include "tests/core/render/scenes.h"
#include "tests/errors.h"

namespace spherule {
namespace {

using test::expect_error;

SphereModel of(std::vector<Sphere> spheres) {
  SphereModel model;
  model.spheres = std::move(spheres);
  return model;
}

const std::uint8_t* at(const Image& image, int x, int y) { return image.at(x, y); }

Image render_one(const SphereModel& model, const RenderOptions& options = {}, const Context& context = {}) {
  return render(std::array{Subject{&model}}, options, context).front();
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

TEST(Render, SilhouetteOfABallIsItsDisc) {
  const double radius = 7.5;
  const Sphere ball{{100, -30, 12}, radius};
  Box box;
  box.include(ball);
  for (const auto& [width, height] : {std::pair{200, 200}, std::pair{300, 160}}) {
    const RenderOptions options{.width = width, .height = height, .samples_per_axis = 4, .views = {View::left}};
    const Image image = render_one(of({ball}), options);
    ASSERT_EQ(image.width, width);
    ASSERT_EQ(image.height, height);
    const double pixel = make_camera({}, View::left, 0, box, width, height).mm_per_pixel;
    EXPECT_NEAR(pixel, 2 * radius / (0.92 * height), 1e-12);
    const Coverage c = coverage(image);
    EXPECT_NEAR(c.area * pixel * pixel / (std::numbers::pi * radius * radius), 1, 5e-4);
    EXPECT_NEAR(c.x, width / 2.0, 0.01);
    EXPECT_NEAR(c.y, height / 2.0, 0.01);
  }
}

// What scene.h promises of a matt surface in the open.
std::array<std::uint8_t, 3> shade(Colour material, const Camera& camera, Vec3 normal) {
  const Colour c = tone(mixed(material, key_light(camera, normal) + sky_light(camera, normal)));
  return {to_srgb(c.x), to_srgb(c.y), to_srgb(c.z)};
}

TEST(Render, ShadingOfABallIsTheFormulaOfItsNormals) {
  const Sphere ball{{5, 6, 7}, 10};
  // A ball in the open hides the lamp from itself only where the lamp is low.
  for (const auto& [projection, shadows] : {std::pair{Projection::orthographic, false},
                                            {Projection::perspective, false},
                                            {Projection::orthographic, true}}) {
    RenderOptions options{
        .width = 120, .height = 120, .samples_per_axis = 4, .shadows = shadows, .ambient_occlusion = false};
    options.camera.projection = projection;
    const Image image = render_one(of({ball}), options);
    Box box;
    box.include(ball);
    const Camera camera = make_camera(options.camera, View::anterior, 0, box, 120, 120);
    int compared = 0;
    for (int y = 0; y < 120; y += 3)
      for (int x = 0; x < 120; x += 3) {
        const auto [origin, direction] = camera.line_of_sight(x + 0.5 - 60, y + 0.5 - 60);
        const Vec3 v = ball.centre - origin;
        const double along = dot(v, direction), off = norm(v - along * direction);
        if (off > 0.93 * ball.radius) continue;
        const double depth = along - std::sqrt(ball.radius * ball.radius - off * off);
        const Vec3 normal = 1 / ball.radius * (origin + depth * direction - ball.centre);
        if (shadows && key_light(camera, normal).x < 0.2) continue;
        const auto expected = shade({0.90, 0.71, 0.50}, camera, normal);
        for (int a = 0; a < 3; ++a)
          ASSERT_NEAR(at(image, x, y)[a], expected[static_cast<std::size_t>(a)], 2) << x << ' ' << y;
        ++compared;
      }
    EXPECT_GT(compared, 500);
  }
}

TEST(Render, PerspectiveSilhouetteOfABallIsItsCone) {
  const Sphere ball{{0, 0, 0}, 10};
  RenderOptions options{.width = 200, .height = 200, .samples_per_axis = 4};
  options.camera.projection = Projection::perspective;
  options.camera.field_of_view = 60;
  options.camera.viewpoint = Viewpoint{{0, -40, 0}, Vec3{0, 0, 0}, {}};
  const Coverage c = coverage(render_one(of({ball}), options));
  // The cone that touches the ball, cut by the plane through its centre.
  const double radius = 40 * std::tan(std::asin(10.0 / 40)), pixel = 2 * 40 * std::tan(std::numbers::pi / 6) / 200;
  EXPECT_NEAR(c.area * pixel * pixel / (std::numbers::pi * radius * radius), 1, 1e-3);
  EXPECT_NEAR(c.x, 100, 0.02);
  EXPECT_NEAR(c.y, 100, 0.02);
}

TEST(Render, ClippingShowsTheDiscThatThePlaneCuts) {
  const double radius = 10;
  const Sphere ball{{1, 2, 3}, radius};
  RenderOptions options{.width = 160, .height = 160, .samples_per_axis = 4};
  options.clip_normal = Vec3{0, -2, 0};  // away goes what is nearer to the viewer
  for (const double depth : {-6.0, 0.0, 6.0}) {
    options.clip_offset_mm = -(ball.centre.y + depth);
    const Image image = render_one(of({ball}), options);
    const double pixel = 2 * radius / (0.92 * 160);
    // In front of the middle the ball's rim shows behind the cut, beyond it the cut is all.
    const double disc = std::sqrt(radius * radius - depth * depth), rim = depth < 0 ? radius : disc;
    EXPECT_NEAR(coverage(image).area * pixel * pixel / (std::numbers::pi * rim * rim), 1, 2e-3) << depth;
    // The cut is flat: one colour.
    int flat = 0;
    for (int y = 0; y < 160; ++y)
      for (int x = 0; x < 160; ++x) flat += std::equal(at(image, x, y), at(image, x, y) + 4, at(image, 80, 80));
    EXPECT_NEAR(flat * pixel * pixel / (std::numbers::pi * disc * disc), 1, 0.03) << depth;
  }
  // Nothing is left: an empty picture.
  options.clip_offset_mm = -100;
  EXPECT_EQ(coverage(render_one(of({ball}), options)).area, 0);
}

TEST(Render, ClippingClosesEveryStyleAlike) {
  const SphereModel model = raw_model();
  RenderOptions options{.width = 120, .height = 120, .samples_per_axis = 2};
  options.clip_normal = Vec3{0, -1, 0};
  std::vector<Coverage> cuts;
  for (const Style style : {Style::spheres, Style::tetrahedra, Style::blobs}) {
    options.style = style;
    options.smoothness = 0.05;
    cuts.push_back(coverage(render_one(model, options)));
  }
  for (const Coverage& c : cuts) {
    EXPECT_NEAR(c.area / cuts[0].area, 1, 0.08);  // balls bulge beyond cells
    EXPECT_NEAR(c.x, cuts[0].x, 1);
    EXPECT_NEAR(c.y, cuts[0].y, 1);
  }
}

TEST(Render, ShadowsAndSkyCanBeLeftOut) {
  const SphereModel model = of({{{0, 0, 0}, 10}, {{-6, -14, 7}, 4}});
  RenderOptions options{.width = 80, .height = 80};
  const Image both = render_one(model, options);
  options.shadows = false;
  const Image no_shadows = render_one(model, options);
  options.ambient_occlusion = false;
  const Image none = render_one(model, options);
  double sum = 0, brighter = 0, brightest = 0;
  for (int y = 0; y < 80; ++y)
    for (int x = 0; x < 80; ++x)
      sum += brightness(both, x, y), brighter += brightness(no_shadows, x, y), brightest += brightness(none, x, y);
  EXPECT_LT(sum, brighter);
  EXPECT_LT(brighter, brightest);
}

// Every covered pixel of one picture has one of the other within a pixel.
void expect_silhouette_within(const Image& a, const Image& b) {
  int covered = 0;
  for (int y = 0; y < a.height; ++y)
    for (int x = 0; x < a.width; ++x) {
      if (at(a, x, y)[3] < 255) continue;
      ++covered;
      bool near = false;
      for (int v = std::max(0, y - 1); v <= std::min(b.height - 1, y + 1); ++v)
        for (int u = std::max(0, x - 1); u <= std::min(b.width - 1, x + 1); ++u) near = near || at(b, u, v)[3] > 0;
      ASSERT_TRUE(near) << x << ' ' << y;
    }
  EXPECT_GT(covered, 1000);
}

TEST(Render, SilhouettesOfTetrahedraAndMarchingCubesAgree) {
  const Scan scan = lumpy_scan();
  const SphereModel model = build_model(scan.volume, scan.rule).model;
  const Mesh mesh =
      marching_cubes(scan.volume, scan.rule, classify_samples(scan.volume, scan.rule), model.solid->boundary);
  for (const View view : {View::anterior, View::left, View::head}) {
    RenderOptions options{
        .width = 100, .height = 100, .samples_per_axis = 2, .style = Style::tetrahedra, .views = {view}};
    const Image tetrahedra = render_one(model, options);
    options.style = Style::surface;
    const Image surface = render(std::array{Subject{&model, &mesh}}, options).front();
    expect_silhouette_within(tetrahedra, surface);
    expect_silhouette_within(surface, tetrahedra);
  }
}

TEST(Render, EveryStyleDrawsTheObject) {
  const Scan scan = lumpy_scan();
  const SphereModel model = build_model(scan.volume, scan.rule).model;
  const Mesh mesh =
      marching_cubes(scan.volume, scan.rule, classify_samples(scan.volume, scan.rule), model.solid->boundary);
  const Subject subject{&model, &mesh};
  RenderOptions options{.width = 64, .height = 64, .samples_per_axis = 2};
  const double whole = coverage(render(std::array{subject}, options).front()).area;
  for (const Style style : {Style::blobs, Style::tetrahedra, Style::surface, Style::points, Style::centres}) {
    options.style = style;
    const Image image = render(std::array{subject}, options).front();
    EXPECT_LT(coverage(image).area, 1.2 * whole);
    EXPECT_GT(coverage(image).area, style >= Style::points ? 0.1 * whole : 0.8 * whole);
    Context many;
    many.threads = 3;
    EXPECT_EQ(render(std::array{subject}, options, many).front().rgba, image.rgba);
  }
  SphereModel balls = model;
  balls.solid.reset();
  for (const Style style : {Style::tetrahedra, Style::points}) {
    options.style = style;
    expect_error([&] { render_one(balls, options); }, ErrorCode::unusable);
  }
}

TEST(Render, BlobsWithoutSmoothnessAreTheSpheres) {
  const SphereModel model = random_balls(100, 3);
  RenderOptions options{.width = 60, .height = 60};
  const Image spheres = render_one(model, options);
  options.style = Style::blobs;
  options.smoothness = 0;
  EXPECT_EQ(render_one(model, options).rgba, spheres.rgba);
  options.smoothness = 1e-5;
  const Image nearly = render_one(model, options);
  EXPECT_NEAR(coverage(nearly).area, coverage(spheres).area, 2);
}

TEST(Render, FiltersLeaveTheChosenBallsInTheirPlaces) {
  const SphereModel model = of({{{0, 0, 0}, 4}, {{30, 0, 0}, 8}, {{60, 0, 0}, 2}});
  RenderOptions options{.width = 300, .height = 60};
  const auto middles = [&] {
    const Image image = render_one(model, options);
    std::string seen;
    for (const auto& [letter, x] : {std::pair{'A', 0.0}, {'B', 30.0}, {'C', 60.0}}) {
      Box box;
      for (const Sphere& s : model.spheres) box.include(s);
      const Vec3 p = make_camera({}, View::anterior, 0, box, 300, 60).seen_at({x, 0, 0});
      if (at(image, static_cast<int>(p.x + 150), 30)[3] == 255) seen += letter;
    }
    return seen;
  };
  EXPECT_EQ(middles(), "ABC");
  options.min_radius_mm = 3;
  EXPECT_EQ(middles(), "AB");
  options.max_radius_mm = 5;
  EXPECT_EQ(middles(), "A");
  options.min_radius_mm = 0;
  options.max_radius_mm.reset();
  options.bucket_count = 3;  // 2 … 4 … 6 … 8
  options.buckets = {0};
  EXPECT_EQ(middles(), "C");
  options.buckets = {1, 2};
  EXPECT_EQ(middles(), "AB");
  options.min_radius_mm = 9;
  expect_error([&] { render_one(model, options); }, ErrorCode::unusable);
}

TEST(Render, ColoursTellRadiusPieceAndCluster) {
  const SphereModel model = of({{{0, 0, 0}, 10}, {{12, 0, 0}, 6}, {{60, 0, 0}, 3}});
  RenderOptions options{
      .width = 400, .height = 100, .background = Background::white, .shadows = false, .legend = false};
  Box box;
  for (const Sphere& s : model.spheres) box.include(s);
  const Camera camera = make_camera({}, View::anterior, 0, box, 400, 100);
  const auto seen = [&](Vec3 p) {
    const Image image = render_one(model, options);
    const Vec3 place = camera.seen_at(p);
    const std::uint8_t* rgba = at(image, static_cast<int>(place.x + 200), static_cast<int>(place.y + 50));
    return std::array{rgba[0], rgba[1], rgba[2]};
  };
  const Vec3 big{-3, 0, 0}, middle{15, 0, 0}, small{60, 0, 0};
  options.colour_by = ColourBy::component;
  const auto redness = [&](Vec3 p) { return 1.0 * seen(p)[0] / seen(p)[2]; };
  EXPECT_NEAR(redness(big) / redness(middle), 1, 0.1);
  EXPECT_GT(redness(big) / redness(small), 2);
  options.colour_by = ColourBy::cluster;
  EXPECT_GT(redness(big) / redness(middle), 2);
  for (const ColourBy by : {ColourBy::radius, ColourBy::contribution}) {
    options.colour_by = by;
    options.colour_map = "grey";
    EXPECT_GT(seen(big)[0], seen(middle)[0]);
    EXPECT_GT(seen(middle)[0], seen(small)[0]);
  }
  options.colour_by = ColourBy::curvature;
  EXPECT_LT(seen(big)[0], seen(small)[0]);
  options.colour_by = ColourBy::radius;
  options.colour_range = std::array{100.0, 200.0};
  EXPECT_LT(seen(big)[0], 20) << "the darkest grey";
}

TEST(Render, ViewsLieSideBySideToOneScale) {
  const SphereModel model = of({{{0, 0, 0}, 10}, {{50, 0, 0}, 10}});
  RenderOptions options{
      .width = 100, .height = 80, .background = Background::white, .views = {View::anterior, View::left, View::head}};
  const Image image = render_one(model, options);
  ASSERT_EQ(image.width, 300);
  ASSERT_EQ(image.height, 80);
  // One ball hides the other from the left; a diameter is 20 of the 70 mm across.
  const auto dark_across = [&](int x0, int x1) {
    int n = 0;
    for (int x = x0; x < x1; ++x) n += at(image, x, 40)[2] < 250;
    return n;
  };
  EXPECT_NEAR(dark_across(100, 200), 20 * 92 / 70, 2);
  EXPECT_NEAR(dark_across(0, 100), 2 * 20 * 92 / 70, 3);
  EXPECT_NEAR(dark_across(200, 300), 2 * 20 * 92 / 70, 3);
}

TEST(Render, TwoModelsBesideAndOverEachOther) {
  const SphereModel big = of({{{0, 0, 0}, 10}}), small = of({{{0, 0, 0}, 5}});
  RenderOptions options{.width = 80, .height = 60};
  const auto both = std::array{Subject{&big}, Subject{&small}};
  const Image beside = render(both, options).front();
  ASSERT_EQ(beside.width, 160);
  const double areas = coverage(beside, 0, 0, 80, 60).area / coverage(beside, 80, 0, 160, 60).area;
  EXPECT_NEAR(areas, 4, 0.1) << "to one scale";
  options.layout = Layout::overlaid;
  const Image hidden = render(both, options).front();
  ASSERT_EQ(hidden.width, 80);
  EXPECT_EQ(at(hidden, 40, 30)[3], 255);
  EXPECT_GT(at(hidden, 40, 30)[0], at(hidden, 40, 30)[2]) << "the first one's colour";
  options.opacity = 0.2;
  const Image through = render(both, options).front();
  EXPECT_GT(at(through, 40, 30)[2], at(through, 40, 30)[0]) << "the second one's";
  EXPECT_EQ(at(through, 40, 30)[3], 255);
  EXPECT_NEAR(at(through, 40, 10)[3], 51, 1) << "only the first one, a fifth of it";
}

TEST(Render, ATurntableIsOneTurn) {
  const SphereModel model = of({{{0, 0, 0}, 10}, {{25, 0, 0}, 5}});
  RenderOptions options{.width = 40, .height = 40, .samples_per_axis = 2, .turntable = 4};
  const auto frames = render(std::array{Subject{&model}}, options);
  ASSERT_EQ(frames.size(), 4U);
  // After a quarter turn the viewer stands at the patient's left, after a half one behind.
  EXPECT_LT(coverage(frames[1]).area, 0.8 * coverage(frames[0]).area);
  EXPECT_NEAR(coverage(frames[2]).area, coverage(frames[0]).area, 3);
  EXPECT_NEAR(coverage(frames[2]).x, 40 - coverage(frames[0]).x, 0.3);
  const std::string gif = encode_gif(frames, 10);
  EXPECT_EQ(gif.substr(0, 6), "GIF89a");
  EXPECT_EQ(encode_gif(frames, 10), gif);
  OIIO::Filesystem::IOMemReader memory(gif.data(), gif.size());
  const auto input = OIIO::ImageInput::create("gif");
  OIIO::ImageSpec spec;
  ASSERT_TRUE(input && input->set_ioproxy(&memory) && input->open("memory.gif", spec));
  EXPECT_EQ(spec.width, 40);
  EXPECT_TRUE(input->seek_subimage(3, 0));
  EXPECT_FALSE(input->seek_subimage(4, 0));
}

TEST(Render, NotesStandAtTheEdges) {
  const SphereModel model = of({{{0, 0, 0}, 10}, {{0, 0, 14}, 6}});
  RenderOptions options{
      .width = 300, .height = 300, .background = Background::white, .colour_by = ColourBy::radius, .scale_bar = true};
  const Image image = render_one(model, options);
  // The bar's left end is at the margin; its length is round and as long as it says: 2 mm, a tenth of the width or
  // more.
  int length = 0;
  for (int x = 0; x < 150; ++x) length += at(image, x, 288)[0] < 100;
  options.legend = false;
  const Image bare = render_one(model, options);
  int different = 0;
  for (int y = 0; y < 300; ++y) different += at(image, 299 - 20, y)[0] < 250 || at(image, 299 - 40, y)[0] < 250;
  EXPECT_GT(different, 20) << "the legend";
  EXPECT_GT(length, 25);
  EXPECT_LT(coverage(bare).area, 300 * 300 + 1);
}

TEST(Render, CamerasAreNeverMirrored) {
  Box box;
  box.include(Sphere{{0, 0, 0}, 1});
  for (const char letter : {'a', 'p', 'r', 'l', 'h', 'f'}) {
    const Camera camera = make_camera({}, static_cast<View>(letter), 0, box, 100, 80);
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
    const RenderOptions options{.width = 60, .height = 60, .samples_per_axis = 2, .views = {static_cast<View>(letter)}};
    const Vec3 centre{40, -20, 7};
    // A small ball beside a large one: the smaller covered half is the marker's.
    const Image beside = render_one(of({{centre, 10}, {centre + 30 * picture_right, 2}}), options);
    const double at_left = coverage(beside, 0, 0, 30, 60).area, at_right = coverage(beside, 30, 0, 60, 60).area;
    EXPECT_GT(at_right, 0) << letter;
    EXPECT_LT(at_right, at_left) << letter;
    const Image above = render_one(of({{centre, 10}, {centre + 30 * picture_up, 2}}), options);
    const double at_top = coverage(above, 0, 0, 60, 30).area, at_bottom = coverage(above, 0, 30, 60, 60).area;
    EXPECT_GT(at_top, 0) << letter;
    EXPECT_LT(at_top, at_bottom) << letter;
  }
}

TEST(Render, KeyLightComesFromTheUpperLeft) {
  const Image image = render_one(of({{{0, 0, 0}, 10}}), {.width = 100, .height = 100});
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
  const Sphere front{{0, -150, 0}, 100}, wall{{0, 1020, 0}, 1000};
  const Image alone = render_one(of({wall}), options);
  const Image both = render_one(of({wall, front}), options);
  // The wall fills the picture's middle alike; the shadow of the small ball falls to the lower right of it.
  int darker = 0, right_of_middle = 0;
  for (int y = 10; y < 90; ++y)
    for (int x = 10; x < 90; ++x)
      if (brightness(both, x, y) < brightness(alone, x, y) - 60) ++darker, right_of_middle += x > 50 && y > 50;
  EXPECT_GT(darker, 20);
  EXPECT_GT(2 * right_of_middle, darker);
}

TEST(Render, HiddenBallsChangeNothing) {
  const SphereModel raw = raw_model();
  SphereModel balls = raw;
  balls.solid.reset();
  for (const View view : {View::anterior, View::head}) {
    const RenderOptions options{.width = 150, .height = 120, .samples_per_axis = 2, .views = {view}};
    const Image filtered = render_one(raw, options), all = render_one(balls, options);
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
  const Image one = render_one(model, options);
  for (const unsigned threads : {2U, 5U}) {
    Context context;
    context.threads = threads;
    EXPECT_EQ(render_one(model, options, context).rgba, one.rgba);
  }
}

TEST(Render, Backgrounds) {
  const SphereModel ball = of({{{0, 0, 0}, 1}});
  RenderOptions options{.width = 40, .height = 40};
  const Image clear = render_one(ball, options);
  EXPECT_EQ(at(clear, 0, 0)[3], 0);
  EXPECT_EQ(at(clear, 20, 20)[3], 255);
  options.background = Background::white;
  const Image white = render_one(ball, options);
  for (int a = 0; a < 4; ++a) EXPECT_EQ(at(white, 0, 0)[a], 255);
  for (int a = 0; a < 4; ++a) EXPECT_EQ(at(white, 20, 20)[a], at(clear, 20, 20)[a]);
  options.background = Background::dark;
  const Image dark = render_one(ball, options);
  EXPECT_LT(at(dark, 0, 0)[0], 50);
  EXPECT_EQ(at(dark, 0, 0)[3], 255);
}

TEST(Render, SmallestPictureAndFlatSets) {
  const Image dot = render_one(of({{{0, 0, 0}, 1}}), {.width = 1, .height = 1});
  EXPECT_GT(dot.rgba[3], 128);
  // Balls on one line, seen along it and across it; and a ball so small that it falls between rays.
  const SphereModel line = of({{{0, 0, 0}, 20}, {{0, 500, 0}, 20}, {{0, 250, 0}, 1e-6}});
  for (const View view : {View::anterior, View::left})
    EXPECT_GT(coverage(render_one(line, {.width = 64, .height = 16, .views = {view}})).area, 0);
}

TEST(Render, FarApartBallsAreFittedToo) {
  const SphereModel model = of({{{-1e9, 0, 0}, 1e8}, {{1e9, 0, 0}, 1e8}});
  const Image image = render_one(model, {.width = 200, .height = 50});
  EXPECT_NEAR(coverage(image).x, 100, 0.5);
}

TEST(Render, RefusesWhatItCannotDraw) {
  const SphereModel ball = of({{{0, 0, 0}, 1}});
  for (const RenderOptions& options : {RenderOptions{.width = 0},
                                       RenderOptions{.width = 8193},
                                       RenderOptions{.height = -5},
                                       RenderOptions{.height = 8193},
                                       RenderOptions{.samples_per_axis = 0},
                                       RenderOptions{.samples_per_axis = 9},
                                       RenderOptions{.smoothness = -0.1},
                                       RenderOptions{.smoothness = NAN},
                                       RenderOptions{.point_radius_mm = -1},
                                       RenderOptions{.min_radius_mm = 2, .max_radius_mm = 1},
                                       RenderOptions{.buckets = {40}},
                                       RenderOptions{.bucket_count = 0},
                                       RenderOptions{.views = {}},
                                       RenderOptions{.views = std::vector<View>(7, View::left)},
                                       RenderOptions{.clip_normal = Vec3{0, 0, 0}},
                                       RenderOptions{.clip_normal = Vec3{NAN, 0, 0}},
                                       RenderOptions{.turntable = 1},
                                       RenderOptions{.turntable = 361},
                                       RenderOptions{.opacity = 0},
                                       RenderOptions{.opacity = 1.1},
                                       RenderOptions{.colour_map = "rainbow"},
                                       RenderOptions{.colour_range = std::array{2.0, 2.0}}})
    expect_error([&] { render_one(ball, options); }, ErrorCode::invalid_argument);
  expect_error([] { render_one({}); }, ErrorCode::unusable);
  expect_error([] { render_one(of({{{1, 2, 3}, 0}})); }, ErrorCode::unusable);
}

TEST(Render, RefusesCamerasThatSeeNothing) {
  const SphereModel ball = of({{{0, 0, 0}, 10}});
  RenderOptions options{.width = 50, .height = 50};
  const auto refused = [&](const Viewpoint& viewpoint, Projection projection) {
    options.camera.viewpoint = viewpoint;
    options.camera.projection = projection;
    expect_error([&] { render_one(ball, options); }, ErrorCode::invalid_argument);
  };
  refused({{1, 2, 3}, Vec3{1, 2, 3}, {}}, Projection::orthographic);              // looks nowhere
  refused({{0, -50, 0}, Vec3{0, 0, 0}, Vec3{0, 3, 0}}, Projection::perspective);  // up is along the sight line
  refused({{0, -50, 0}, Vec3{0, 0, 0}, Vec3{0, 0, 0}}, Projection::perspective);  // no up
  refused({{0, -50, 0}, Vec3{0, -100, 0}, {}}, Projection::perspective);          // turned away
  refused({{0, -50, 0}, Vec3{10, -50, 0}, {}}, Projection::orthographic);         // beside it
  refused({{0, 5, 0}, Vec3{0, 20, 0}, {}}, Projection::perspective);              // within
  refused({{NAN, 5, 0}, Vec3{0, 20, 0}, {}}, Projection::perspective);
  options.camera.field_of_view = 0;
  refused({{0, -50, 0}, Vec3{0, 0, 0}, {}}, Projection::perspective);
  // From within what is cut away one sees the cut.
  options.camera = {};
  options.camera.viewpoint = Viewpoint{{0, -8, 0}, Vec3{0, 0, 0}, {}};
  options.camera.projection = Projection::perspective;
  options.clip_normal = Vec3{0, -1, 0};
  EXPECT_GT(coverage(render_one(ball, options)).area, 2000);
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
  expect_error([&] { render_one(random_balls(50, 2), {.width = 256, .height = 256}, context); }, ErrorCode::cancelled);
  EXPECT_GT(last, 0.3);
  EXPECT_LT(last, 1);
}

TEST(Png, HoldsTheSamePixelsAndIsTheSameEachTime) {
  const Image image = render_one(random_balls(50, 3), {.width = 61, .height = 43});
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
