// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/drawing.h"

#include <gtest/gtest.h>

#include <cmath>
#include <ctime>
#include <numbers>
#include <random>

#include "core/render/ticks.h"

namespace spherule {
namespace {

constexpr Ink kBlack{0, 0, 0};

double cover(const Image& image) {
  double sum = 0;
  for (std::size_t i = 3; i < image.rgba.size(); i += 4) sum += image.rgba[i] / 255.0;
  return sum;
}

Image painted(const Drawing& drawing) {
  Image image = blank_image(drawing.width(), drawing.height());
  paint(drawing, image);
  return image;
}

TEST(Drawing, AreasCoverWhatTheyAre) {
  Drawing drawing(20, 20);
  drawing.rectangle(2.25, 3.5, 10.5, 4, kBlack);
  const Image image = painted(drawing);
  EXPECT_NEAR(cover(image), 42, 0.05);
  EXPECT_EQ(image.at(5, 5)[3], 255);
  EXPECT_EQ(image.at(2, 5)[3], 191);
  EXPECT_EQ(image.at(5, 3)[3], 128);
}

TEST(Drawing, TrianglesThatMeetHaveNoSeam) {
  Drawing drawing(60, 60);
  std::vector<std::vector<Point2>> fan;
  for (int i = 0; i < 17; ++i) {
    const double a = 2 * std::numbers::pi * i / 17, b = 2 * std::numbers::pi * (i + 1) / 17;
    fan.push_back(
        {{30.3, 29.6}, {30 + 28 * std::cos(a), 30 + 28 * std::sin(a)}, {30 + 28 * std::cos(b), 30 + 28 * std::sin(b)}});
  }
  drawing.areas(fan, kBlack);
  const Image image = painted(drawing);
  for (int y = 0; y < 60; ++y)
    for (int x = 0; x < 60; ++x)
      ASSERT_TRUE(image.at(x, y)[3] == 255 || std::hypot(x + 0.5 - 30, y + 0.5 - 30) > 26) << x << ' ' << y;
}

TEST(Drawing, LinesDiscsAndRingsHaveTheirSize) {
  Drawing lines(100, 100), discs(100, 100), rings(100, 100);
  lines.line({10, 10}, {70, 80}, 3, kBlack);
  EXPECT_NEAR(cover(painted(lines)), 3 * std::hypot(60, 70) + std::numbers::pi * 2.25, 3);
  discs.discs({{{50.2, 49.7}, 20}}, kBlack);
  EXPECT_NEAR(cover(painted(discs)), std::numbers::pi * 400, 2);
  rings.circles({{{50, 50}, 30}}, 2, kBlack);
  EXPECT_NEAR(cover(painted(rings)), 2 * std::numbers::pi * 30 * 2, 2);
}

// Against every pixel by its distance from the segment.
TEST(Drawing, LinesCoverWhatIsNearThem) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> place(-20, 70), size(0.5, 9);
  for (int i = 0; i < 200; ++i) {
    const Point2 a{place(random), place(random)};
    const Point2 b{i % 5 == 0 ? a.x : place(random), i % 7 == 0 ? a.y : place(random)};
    const double width = size(random), dx = b.x - a.x, dy = b.y - a.y, squared = dx * dx + dy * dy;
    Drawing drawing(50, 40);
    drawing.line(a, b, width, {0, 0, 0});
    const Image image = painted(drawing);
    for (int y = 0; y < 40; ++y)
      for (int x = 0; x < 50; ++x) {
        const double u = x + 0.5 - a.x, v = y + 0.5 - a.y;
        const double t = squared > 0 ? std::clamp((u * dx + v * dy) / squared, 0.0, 1.0) : 0;
        const double cover = std::clamp(width / 2 + 0.5 - std::hypot(u - t * dx, v - t * dy), 0.0, 1.0);
        ASSERT_NEAR(image.at(x, y)[3], 255 * cover, 1) << i << " " << x << " " << y;
      }
  }
}

TEST(Drawing, LargePicturesArePaintedInTheirArea) {
  Drawing drawing(4096, 4096);
  drawing.rectangle(0.5, 0.5, 4094, 4094, {10, 20, 30});
  std::vector<std::vector<Point2>> lines;
  for (int i = 0; i < 300; ++i) lines.push_back({{10, 10.0 * i}, {4000, 4000 - 10.0 * i}});
  drawing.lines(std::move(lines), 2, {});
  Image image = blank_image(4096, 4096);
  const auto begin = std::clock();
  paint(drawing, image);
  EXPECT_EQ(image.at(4050, 2000)[3], 255);
  EXPECT_EQ(image.at(0, 2000)[3], 128);
  EXPECT_EQ(image.at(4095, 2000)[3], 0);
  EXPECT_LT(static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC, 4);
}

TEST(Drawing, CrossingLinesOfOneInkAreNotDoubled) {
  Drawing drawing(40, 40);
  drawing.lines({{{5, 20}, {35, 20}}, {{20, 5}, {20, 35}}}, 6, {255, 0, 0, 0.5});
  EXPECT_EQ(painted(drawing).at(20, 20)[3], 128);
}

TEST(Drawing, InkLiesOverWhatIsThere) {
  Image image = blank_image(2, 1);
  std::fill(image.rgba.begin(), image.rgba.begin() + 4, std::uint8_t{255});
  Drawing drawing(2, 1);
  drawing.rectangle(0, 0, 2, 1, {200, 0, 100, 0.5});
  paint(drawing, image);
  EXPECT_EQ(std::vector<int>(image.rgba.begin(), image.rgba.end()),
            (std::vector<int>{228, 128, 178, 255, 200, 0, 100, 128}));
}

TEST(Drawing, WhatLiesOutsideIsLeftOut) {
  Drawing drawing(10, 10);
  drawing.line({-1e6, 5}, {1e6, 5}, 1, kBlack);
  drawing.discs({{{-50, -50}, 10}, {{5, 1e7}, 3}}, kBlack);
  drawing.rectangle(8, -1e9, 1e9, 2e9, kBlack);
  drawing.text({-500, 4}, 5, Anchor::start, "away", kBlack);
  EXPECT_NEAR(cover(painted(drawing)), 8 + 20, 0.6);
}

TEST(Drawing, WordsStandAtTheirAnchor) {
  for (const auto& [anchor, left, right] :
       {std::tuple{Anchor::start, 100, 200}, {Anchor::middle, 60, 140}, {Anchor::end, 0, 102}}) {
    Drawing drawing(200, 40);
    drawing.text({100, 30}, 14, anchor, "mm³", kBlack);
    const Image image = painted(drawing);
    EXPECT_GT(cover(image), 50);
    for (int y = 0; y < 40; ++y)
      for (int x = 0; x < 200; ++x)
        if (image.at(x, y)[3] > 0) {
          ASSERT_GE(x, left - 2);
          ASSERT_LE(x, right);
          ASSERT_GE(y, 14);
          ASSERT_LE(y, 33);
        }
  }
  Drawing upwards(40, 200);
  upwards.text_upwards({30, 150}, 14, Anchor::start, "Count", kBlack);
  const Image image = painted(upwards);
  for (int y = 151; y < 200; ++y)
    for (int x = 0; x < 40; ++x) ASSERT_EQ(image.at(x, y)[3], 0);
  EXPECT_GT(cover(image), 50);
}

TEST(Drawing, EveryGlyphDiffersFromTheUnknownOne) {
  const auto picture = [](std::string_view words) {
    Drawing drawing(30, 40);
    drawing.text({5, 30}, 18, Anchor::start, words, kBlack);
    return painted(drawing).rgba;
  };
  const auto unknown = picture("\u2603");
  EXPECT_EQ(picture("\xff"), unknown);
  std::string known;
  for (char c = '!'; c <= '~'; ++c)
    if (std::string_view("#$&@\\^`{}~").find(c) == std::string_view::npos) known += c;
  for (const char c : known) {
    EXPECT_NE(picture(std::string(1, c)), unknown) << c;
    for (const char d : known)
      EXPECT_TRUE(c == d || picture(std::string(1, c)) != picture(std::string(1, d))) << c << d;
  }
  for (const char* c : {"°", "²", "³", "×", "−", "–", "±", "≤", "≥", "µ", "·"}) EXPECT_NE(picture(c), unknown) << c;
}

TEST(Drawing, AsSvg) {
  Drawing drawing(30, 20);
  drawing.line({1, 2}, {3.14159, 4}, 1.5, {255, 128, 0, 0.25});
  drawing.areas({{{0, 0}, {1, 0}, {1, 1}}}, kBlack);
  drawing.circles({{{5, 6}, 7}}, 1, kBlack);
  drawing.discs({{{5, 6}, 7}}, kBlack);
  drawing.text({1, 2}, 7.2, Anchor::end, "a < b & \"c\"\x01", kBlack);
  drawing.text_upwards({1, 2}, 7.2, Anchor::middle, "up", kBlack);
  EXPECT_EQ(
      to_svg(drawing, "abcde"),
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"30\" height=\"20\" viewBox=\"0 0 30 20\" "
      "font-family=\"sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
      "<image width=\"30\" height=\"20\" style=\"image-rendering:pixelated\" "
      "href=\"data:image/png;base64,YWJjZGU=\"/>\n"
      "<path d=\"M1 2L3.14 4\" fill=\"none\" stroke-width=\"1.5\" stroke-linecap=\"round\" stroke-linejoin=\"round\" "
      "stroke=\"#ff8000\" stroke-opacity=\"0.25\"/>\n"
      "<path d=\"M0 0L1 0L1 1Z\" fill=\"#000000\"/>\n"
      "<g fill=\"none\" stroke-width=\"1\" stroke=\"#000000\">\n<circle cx=\"5\" cy=\"6\" r=\"7\"/>\n</g>\n"
      "<g fill=\"#000000\">\n<circle cx=\"5\" cy=\"6\" r=\"7\"/>\n</g>\n"
      "<text x=\"1\" y=\"2\" font-size=\"10\" text-anchor=\"end\" fill=\"#000000\">a &lt; b &amp; \"c\"</text>\n"
      "<text x=\"1\" y=\"2\" font-size=\"10\" text-anchor=\"middle\" fill=\"#000000\" transform=\"rotate(-90 1 "
      "2)\">up</text>\n"
      "</svg>\n");
}

TEST(Drawing, Addition) {
  Drawing part(5, 5), whole(30, 30);
  part.rectangle(0, 0, 5, 5, kBlack);
  part.discs({{{2, 2}, 1}}, kBlack);
  part.text({0, 4}, 4, Anchor::start, "i", kBlack);
  whole.add(part, 20, 10);
  EXPECT_EQ(whole.shapes().size(), 3U);
  const Image image = painted(whole);
  EXPECT_EQ(image.at(22, 12)[3], 255);
  EXPECT_EQ(image.at(2, 2)[3], 0);
}

TEST(Ticks, AreRoundAndWithin) {
  EXPECT_EQ(ticks(0, 10, 5), (std::vector<double>{0, 2, 4, 6, 8, 10}));
  EXPECT_EQ(ticks(-1.3, 1.1, 4), (std::vector<double>{-1, 0, 1}));
  EXPECT_EQ(ticks(5, 5, 4), (std::vector<double>{5}));
  for (const double scale : {1e-7, 0.03, 1.0, 750.0, 1e9}) {
    const auto all = ticks(0.13 * scale, 0.97 * scale, 6);
    EXPECT_GE(all.size(), 3U);
    EXPECT_LE(all.size(), 7U);
    EXPECT_GE(all.front(), 0.1299 * scale);
    EXPECT_LE(all.back(), 0.9701 * scale);
  }
  EXPECT_EQ(log_ticks(1, 1000), (std::vector<double>{1, 10, 100, 1000}));
  EXPECT_EQ(log_ticks(3, 70), (std::vector<double>{5, 10, 20, 50}));
  EXPECT_EQ(round_step(3), 5);
  EXPECT_EQ(round_step(0.02), 0.02);
  EXPECT_EQ(round_step(7e5), 1e6);
}

TEST(Ticks, EndWhereNumbersAreFarApart) {
  for (const double lo : {1e17, -1e17, 1e30, 9007199254740992.0, 1e-300}) {
    const double hi = std::nextafter(std::nextafter(lo, INFINITY), INFINITY);
    const auto all = ticks(lo, hi, 6);
    EXPECT_LE(all.size(), 7U);
    for (std::size_t i = 1; i < all.size(); ++i) EXPECT_LT(all[i - 1], all[i]);
  }
}

TEST(Ticks, Labels) {
  EXPECT_EQ(label(0), "0");
  EXPECT_EQ(label(0.1 + 0.2), "0.3");
  EXPECT_EQ(label(-12.5), "−12.5");
  EXPECT_EQ(label(2e-6), "2e-6");
  EXPECT_EQ(label(5e20), "5e20");
  EXPECT_EQ(with_commas(1234567), "1,234,567");
  EXPECT_EQ(with_commas(-999), "-999");
  EXPECT_EQ(with_commas(-1000), "-1,000");
}

}  // namespace
}  // namespace spherule
