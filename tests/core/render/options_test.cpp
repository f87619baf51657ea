// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/options.h"

#include <gtest/gtest.h>

#include "core/base/error.h"

namespace spherule {
namespace {

std::string pointer_of(const OptionTexts& given) {
  try {
    parse_render_options(given);
    return "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::invalid_argument);
    return e.fields().at(0).pointer;
  }
}

TEST(RenderOptionTexts, NoneAreTheDefaults) {
  const RenderOptions options = parse_render_options({});
  EXPECT_EQ(options, RenderOptions{});
  EXPECT_EQ(parse_render_options(render_option_texts(options)), options);
}

TEST(RenderOptionTexts, EveryOptionReadsBack) {
  OptionTexts given{
      {"style", "blobs"},       {"smoothness", "0.25"},         {"min_radius", "1.5"}, {"max_radius", "1e2"},
      {"buckets", "7,0,3-5,4"}, {"bucket_count", "10"},         {"width", "640"},      {"height", "480"},
      {"samples", "5"},         {"background", "gradient"},     {"views", "a,l,h"},    {"projection", "perspective"},
      {"field_of_view", "40"},  {"clip", "0,-1,0.5,12.25"},     {"turntable", "36"},   {"layout", "overlaid"},
      {"shadows", "false"},     {"ambient_occlusion", "false"}, {"opacity", "0.5"},    {"colour_by", "curvature"},
      {"colour_map", "tide"},   {"colour_range", "-0.5,0.5"},   {"legend", "false"},   {"marker", "true"},
      {"scale_bar", "true"}};
  const RenderOptions options = parse_render_options(given);
  EXPECT_EQ(options.style, Style::blobs);
  EXPECT_EQ(options.buckets, (std::vector<int>{0, 3, 4, 5, 7}));
  EXPECT_EQ(options.views, (std::vector<View>{View::anterior, View::left, View::head}));
  EXPECT_EQ(options.clip_offset_mm, 12.25);
  EXPECT_EQ(options.max_radius_mm, 100);
  EXPECT_TRUE(options.orientation_marker);
  const OptionTexts canonical = render_option_texts(options);
  EXPECT_EQ(parse_render_options(canonical), options);
  EXPECT_EQ(render_option_texts(parse_render_options(canonical)), canonical);
  given[4].second = "0,3-5,7", given[3].second = "100";
  EXPECT_EQ(canonical, given);

  const OptionTexts from{{"position", "1,-2,3e2"}, {"look_at", "0,0,0"}, {"up", "0,0,1"}, {"fit", "true"}};
  const RenderOptions placed = parse_render_options(from);
  EXPECT_EQ(placed.camera.viewpoint->position, (Vec3{1, -2, 300}));
  EXPECT_TRUE(placed.camera.fit);
  EXPECT_EQ(parse_render_options(render_option_texts(placed)), placed);
}

TEST(RenderOptionTexts, SameThingsHaveSameTexts) {
  EXPECT_EQ(render_option_texts(parse_render_options({{"clip", "-0,1.0,0"}})),
            render_option_texts(parse_render_options({{"clip", "0,1e0,0.0"}})));
  EXPECT_EQ(render_option_texts(parse_render_options({{"views", "l"}})),
            render_option_texts(parse_render_options({{"view", "l"}})));
}

TEST(RenderOptionTexts, WhatMakesNoSenseIsRefusedByName) {
  for (const std::string_view name : render_option_names()) {
    const std::string n(name);
    EXPECT_EQ(pointer_of({{n, n == "colour_map" ? "ember" : "?"}}), n);
    EXPECT_EQ(pointer_of({{n, ""}}), n);
  }
  const std::vector<OptionTexts> bad{{{"wobble", "1"}},
                                     {{"width", "1"}, {"width", "1"}},
                                     {{"width", "1.5"}},
                                     {{"width", "99999999999"}},
                                     {{"opacity", "nan"}},
                                     {{"opacity", "inf"}},
                                     {{"smoothness", "0.5"}},
                                     {{"point_radius", "1"}, {"style", "blobs"}},
                                     {{"bucket_count", "20"}},
                                     {{"buckets", "5-3"}},
                                     {{"buckets", "1-2-3"}},
                                     {{"buckets", "-1"}},
                                     {{"buckets", "0-2000000000"}},
                                     {{"clip", "1,2"}},
                                     {{"clip", "1,2,3,4,5"}},
                                     {{"views", "a,"}},
                                     {{"view", "ap"}},
                                     {{"views", "a"}, {"view", "l"}},
                                     {{"view", "a"}, {"position", "1,2,3"}},
                                     {{"look_at", "1,2,3"}},
                                     {{"fit", "true"}},
                                     {{"field_of_view", "30"}},
                                     {{"colour_range", "1,2"}},
                                     {{"legend", "true"}, {"colour_by", "component"}},
                                     {{"shadows", "yes"}},
                                     {{"style", "Blobs"}}};
  for (const OptionTexts& given : bad) EXPECT_EQ(pointer_of(given), given.front().first);
}

TEST(SliceOptionTexts, EveryOptionReadsBack) {
  EXPECT_EQ(parse_slice_options({}), SliceOptions{});
  OptionTexts given{
      {"width", "640"},     {"height", "480"},      {"window", "400"},          {"level", "40.5"},
      {"smooth", "false"},  {"image", "true"},      {"region", "0,-0.5,12,30"}, {"show", "circles,points,circles"},
      {"letters", "false"}, {"scale_bar", "false"}, {"caption", "false"}};
  const SliceOptions options = parse_slice_options(given);
  EXPECT_EQ(options.window, (Window{400, 40.5}));
  EXPECT_EQ(options.show, (std::vector<Overlay>{Overlay::points, Overlay::circles}));
  given[7].second = "points,circles";
  EXPECT_EQ(slice_option_texts(options), given);
  EXPECT_EQ(parse_slice_options(slice_option_texts(options)), options);
  const SliceOptions paper = parse_slice_options({{"image", "false"}});
  EXPECT_EQ(parse_slice_options(slice_option_texts(paper)), paper);
}

TEST(SliceOptionTexts, WhatMakesNoSenseIsRefusedByName) {
  const auto pointer = [](const OptionTexts& given) -> std::string {
    try {
      check_slice_options(parse_slice_options(given));
      return "";
    } catch (const Error& e) {
      return e.fields().at(0).pointer;
    }
  };
  EXPECT_EQ(pointer({}), "");
  for (const std::string_view name : slice_option_names()) EXPECT_EQ(pointer({{std::string(name), "?"}}), name);
  const std::vector<OptionTexts> bad{
      {{"width", "0"}},        {{"height", "8193"}},  {{"window", "0"}, {"level", "5"}},
      {{"region", "0,0,0,1"}}, {{"region", "0,0,1"}}, {{"smooth", "true"}, {"image", "false"}},
      {{"show", ""}}};
  for (const OptionTexts& given : bad) EXPECT_EQ(pointer(given), given.front().first);
  EXPECT_EQ(pointer({{"level", "5"}}), "window");
}

}  // namespace
}  // namespace spherule
