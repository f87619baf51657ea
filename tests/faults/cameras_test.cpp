// SPDX-License-Identifier: GPL-3.0-or-later
//
// Pictures that nobody would ask for: cameras, planes, radii and colours at the ends of their ranges and beyond, of
// models at the ends of what can be imported. Each is a picture or a refusal that says why, and each ends soon. The
// long form draws thousands.
#include <gtest/gtest.h>

#include <ctime>
#include <random>
#include <string_view>

#include "core/base/error.h"
#include "core/compare/marching_cubes.h"
#include "core/register/picture.h"
#include "core/render/options.h"
#include "core/render/render.h"
#include "tests/core/render/scenes.h"
#include "tests/long_form.h"

namespace spherule {
namespace {

using Random = std::mt19937_64;

int how_many(int few, int many) { return test::long_form() ? many : few; }

std::string_view one_of(std::span<const std::string_view> words, Random& random) {
  return words[random() % words.size()];
}

// Numbers as a hostile or a careless caller writes them.
constexpr auto kNumbers = std::to_array<std::string_view>(
    {"0",     "1",        "-1",     "0.3",   "-7.25", "20",   "1e-20", "1e-300", "1e-9", "-1e-9",
     "300",   "3e5",      "-3e5",   "1e9",   "-1e9",  "1e12", "-1e12", "1e17",   "1e30", "-1e30",
     "1e308", "-1.7e308", "5e-324", "1e999", "inf",   "nan",  "-0.0",  "1e-12",  "2e12", "1e18",
     "60.5",  "1e-18",    "-25",    "12",    "1e6",   "7e5",  "4",     "120",    "45"});

// Mostly numbers of use, so that most requests come as far as being drawn.
std::string number(Random& random) {
  if (random() % 3 != 0) return std::to_string(static_cast<int>(random() % 81) - 40);
  return std::string(one_of(kNumbers, random));
}
std::string numbers(int count, Random& random) {
  std::string list = number(random);
  for (int i = 1; i < count; ++i) list += "," + number(random);
  return list;
}

constexpr auto kStyles =
    std::to_array<std::string_view>({"spheres", "blobs", "tetrahedra", "surface", "points", "centres"});
constexpr auto kColours = std::to_array<std::string_view>({"none", "radius", "component", "cluster", "curvature"});

// An option that fits the style, with a number that may not.
void add_odd(OptionTexts& texts, Random& random) {
  const auto style = texts.front().second;
  const auto add = [&](const char* name, std::string text) { texts.emplace_back(name, std::move(text)); };
  if (random() % 2 == 0) {
    add("position", numbers(3, random));
    if (random() % 2 == 0) add("look_at", numbers(3, random));
    if (random() % 3 == 0) add("up", numbers(3, random));
    if (random() % 4 == 0) add("fit", "true");
  } else if (random() % 4 == 0) {
    add("views", "a,h");
  }
  if (random() % 2 == 0) {
    add("projection", "perspective");
    if (random() % 2 == 0) add("field_of_view", number(random));
  }
  if (style == "blobs" && random() % 2 == 0) add("smoothness", number(random));
  if ((style == "points" || style == "centres") && random() % 2 == 0) add("point_radius", number(random));
  if (random() % 4 == 0) add("clip", numbers(3 + static_cast<int>(random() % 2), random));
  if (random() % 6 == 0) add("min_radius", number(random));
  if (random() % 6 == 0) add("max_radius", number(random));
  if (random() % 6 == 0) add("opacity", number(random));
  if (random() % 12 == 0) add("turntable", number(random));
  if (random() % 3 == 0) {
    const std::string by(one_of(kColours, random));
    add("colour_by", by);
    if ((by == "radius" || by == "curvature") && random() % 2 == 0) add("colour_range", numbers(2, random));
  }
  if (random() % 4 == 0) add("scale_bar", "true");
}

OptionTexts odd_request(std::span<const std::string_view> styles, Random& random) {
  OptionTexts texts{{"style", std::string(one_of(styles, random))}, {"width", "40"}, {"height", "24"}};
  if (random() % 6 != 0) texts.emplace_back("legend", "false");
  if (random() % 2 == 0) texts.emplace_back("samples", "1");
  add_odd(texts, random);
  // A legend is for colours that are numbers.
  const auto by = std::ranges::find(texts, "colour_by", &std::pair<std::string, std::string>::first);
  if (by == texts.end() || (by->second != "radius" && by->second != "curvature"))
    std::erase_if(texts, [](const auto& text) { return text.first == "legend"; });
  return texts;
}

std::string words_of(const OptionTexts& texts) {
  std::string words;
  for (const auto& [name, text] : texts) words += (words.empty() ? "" : "&") + name + "=" + text;
  return words;
}

struct Tally {
  int drawn = 0, refused = 0;
};

// Draws by `picture`, which must give a picture or say what is wrong with the request.
template <typename Picture>
void expect_an_answer(const OptionTexts& texts, Tally& tally, Picture&& picture) {
  SCOPED_TRACE(words_of(texts));
  const std::clock_t begin = std::clock();  // a busy machine does not matter
  try {
    const RenderOptions options = parse_render_options(texts);
    check_render_options(options);
    picture(options);
    ++tally.drawn;
  } catch (const Error& error) {
    ++tally.refused;
    EXPECT_TRUE(error.code() == ErrorCode::invalid_argument || error.code() == ErrorCode::unusable) << error.what();
    EXPECT_EQ(std::string_view(error.what()).back(), '.');
  } catch (const std::exception& defect) {
    ADD_FAILURE() << defect.what();
  }
  EXPECT_LT(static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC, 10);
}

struct Drawable {
  SphereModel model;
  std::optional<Mesh> surface{};
};

// Where spheres that can be imported end, and what is made of volumes.
std::vector<Drawable> odd_models() {
  std::vector<Drawable> models;
  const auto add = [&](std::vector<Sphere> spheres) {
    models.push_back({.model = {.spheres = std::move(spheres), .solid = {}}});
  };
  const Scan scan = lumpy_scan();
  BuiltModel build = build_model(scan.volume, scan.rule);
  const InsideSamples samples = classify_samples(scan.volume, scan.rule);
  Mesh mesh = marching_cubes(scan.volume, scan.rule, samples, build.model.solid->boundary);
  models.push_back({std::move(build.model), std::move(mesh)});
  models.push_back({.model = random_balls(60, 4)});
  const double least = 1e-18, most = 1e9;
  add({{{0, 0, 0}, 1}});
  add({{{0, 0, 0}, least}, {{1, 0, 0}, least}, {{0, 1, 0}, least}});
  add({{{0, 0, 0}, least}, {{0, 0, 0}, least}});
  add({{{0, 0, 0}, 1}, {{most, most, most}, 1}, {{-most, 0, 0}, least}});
  add({{{most, -most, most}, most}, {{0, 0, 0}, 1}, {{1, 1, 1}, least}});
  add({{{most, most, -most}, 1e-3}, {{most, most, -most}, 0}});
  add({{{most, 0, 0}, 1}, {{most - 3, 0, 0}, 1}});
  add({{{0, 0, 0}, 1e-170}, {{1, 0, 0}, 1e-170}, {{0, 1, 0}, 1e-170}});  // of a caller who checks nothing
  return models;
}

TEST(Cameras, GiveAPictureOrSayWhyNot) {
  const std::vector<Drawable> models = odd_models();
  Random random(14);
  Tally tally;
  for (int i = 0, n = how_many(250, 4000); i < n; ++i) {
    const Drawable& what = models[i % 2 == 0 ? 0 : random() % models.size()];
    expect_an_answer(odd_request(kStyles, random), tally, [&](const RenderOptions& options) {
      const Subject subject{.model = &what.model, .surface = what.surface ? &*what.surface : nullptr};
      if (options.style == Style::surface && !what.surface) return;
      const std::vector<Image> frames = render(std::span(&subject, 1), options);
      EXPECT_EQ(frames.size(), static_cast<std::size_t>(std::max(1, options.turntable)));
      EXPECT_FALSE(encode_png(frames.front()).empty());
    });
  }
  EXPECT_GT(tally.drawn, tally.refused / 4);
  EXPECT_GT(tally.refused, tally.drawn / 8);
}

TEST(Cameras, GiveAPictureOfARegistrationOrSayWhyNot) {
  const std::vector<Drawable> models = odd_models();
  constexpr auto styles = std::to_array<std::string_view>({"spheres", "blobs", "centres"});
  Random random(7);
  Tally tally;
  for (int i = 0, n = how_many(60, 1000); i < n; ++i) {
    const SphereModel& fixed = models[random() % models.size()].model;
    const SphereModel& moving = models[random() % models.size()].model;
    const double scale = std::pow(10.0, static_cast<int>(random() % 19) - 9);
    const AffineMap map{scaled(scale, rotation(Vec3{0.3, 0.2, 0.1})), {static_cast<double>(random() % 100), 0, 0}};
    expect_an_answer(odd_request(styles, random), tally, [&](RenderOptions options) {
      options.layout = Layout::overlaid;
      EXPECT_EQ(before_and_after(fixed, moving, map, options).height, 24);
    });
  }
  EXPECT_GT(tally.drawn, 0);
}

// The requests that once ended a server.
TEST(Cameras, ThatEndedAServerDoSoNoMore) {
  const std::vector<Drawable> models = odd_models();
  Tally tally;
  for (const OptionTexts& texts : std::initializer_list<OptionTexts>{
           {{"style", "spheres"}, {"position", "1e30,0,0"}},
           {{"style", "blobs"}, {"position", "1e30,0,0"}, {"projection", "perspective"}},
           {{"style", "spheres"}, {"position", "0,-90,0"}, {"look_at", "1e30,0,0"}},
           {{"style", "centres"}, {"point_radius", "1e-20"}},
           {{"style", "points"}, {"point_radius", "1e-200"}},
           {{"style", "blobs"}, {"smoothness", "1e-300"}},
           {{"style", "blobs"}, {"position", "3e5,0,0"}, {"projection", "perspective"}},
           {{"style", "blobs"}, {"position", "0,1e12,1e5"}, {"projection", "perspective"}, {"field_of_view", "1"}},
           {{"style", "spheres"}, {"colour_by", "radius"}, {"colour_range", "1e17,1.0000000000000002e17"}},
           {{"style", "spheres"}, {"clip", "1e-170,0,0"}},
           {{"style", "spheres"}, {"clip", "0,0,1e12,1e12"}}}) {
    for (const Drawable& what : models) {
      OptionTexts small = texts;
      small.emplace_back("width", "60"), small.emplace_back("height", "60");
      expect_an_answer(small, tally, [&](const RenderOptions& options) {
        const Subject subject{.model = &what.model};
        static_cast<void>(render(std::span(&subject, 1), options));
      });
    }
  }
  EXPECT_GT(tally.drawn, 20);
}

}  // namespace
}  // namespace spherule
