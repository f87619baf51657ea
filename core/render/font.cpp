// SPDX-License-Identifier: GPL-3.0-or-later
//
// Glyphs on a grid of half a dozen by nine units. A point is two characters: x and y, 0 … 9 a b c…; the baseline is at
// y = 3, small letters reach 9, capitals c. A stroke of a glyph is straight from point to point, or, after '~', a
// quadratic B-spline that begins at its first point and ends at its last, or, after '@', a closed one.
#include "core/render/font.h"

#include <algorithm>
#include <array>
#include <cstdint>

namespace spherule {
namespace {

constexpr double kCapital = 9;

struct Glyph {
  char32_t character;
  int advance;
  std::string_view strokes;
};

constexpr std::array kGlyphs = std::to_array<Glyph>({
    {U' ', 4, ""},
    {U'0', 8, "@03 63 6c 0c"},
    {U'1', 5, "0a 3c 33"},
    {U'2', 7, "~0a 1c 5c 5a 58 26 03 03|03 53"},
    {U'3', 7, "~0b 0c 5c 5a 58 28|~28 58 58 53 13 04"},
    {U'4', 8, "65 05 4c 43"},
    {U'5', 7, "5c 0c 08|~08 39 59 56 53 13 04"},
    {U'6', 8, "~5c 0c 06|@03 63 69 09"},
    {U'7', 7, "0c 5c 23"},
    {U'8', 8, "@18 58 5c 1c|@03 63 68 08"},
    {U'9', 8, "~13 63 69|@06 66 6c 0c"},
    {U'A', 8, "03 3c 63|15 55"},
    {U'B', 8, "03 0c|~0c 5c 5c 58 48 08|~08 38 68 63 43 03"},
    {U'C', 8, "~6b 5c 0c 08 07 03 53 64"},
    {U'D', 8, "03 0c|~0c 2c 6c 68 67 63 23 03"},
    {U'E', 7, "5c 0c 03 53|08 48"},
    {U'F', 7, "5c 0c 03|08 48"},
    {U'G', 9, "~6b 5c 0c 08 07 03 43 63 65 67|67 47"},
    {U'H', 8, "03 0c|63 6c|08 68"},
    {U'I', 3, "13 1c"},
    {U'J', 6, "~4c 46 43 13 04|4c 46"},
    {U'K', 8, "03 0c|06 6c|28 63"},
    {U'L', 7, "0c 03 53"},
    {U'M', 9, "03 0c 46 8c 83"},
    {U'N', 8, "03 0c 63 6c"},
    {U'O', 9, "@03 73 7c 0c"},
    {U'P', 7, "03 0c|~0c 5c 6c 67 47 07"},
    {U'Q', 9, "@03 73 7c 0c|45 72"},
    {U'R', 8, "03 0c|~0c 5c 6c 67 47 07|37 63"},
    {U'S', 7, "~5b 4c 0c 08 47 68 53 13 04"},
    {U'T', 8, "0c 6c|3c 33"},
    {U'U', 8, "~0c 06 03 63 66 6c|0c 06|66 6c"},
    {U'V', 8, "0c 33 6c"},
    {U'W', 10, "0c 23 4a 63 8c"},
    {U'X', 8, "03 6c|0c 63"},
    {U'Y', 8, "0c 37 6c|37 33"},
    {U'Z', 8, "0c 6c 03 63"},
    {U'a', 7, "~18 19 59 57 53|57 53|~56 06 03 33 55"},
    {U'b', 7, "0c 03|@03 53 59 09"},
    {U'c', 6, "~48 49 09 06 03 43 44"},
    {U'd', 7, "5c 53|@03 53 59 09"},
    {U'e', 7, "06 56|~56 59 09 06 03 43 54"},
    {U'f', 5, "~4c 1c 1a 19|1a 13|09 39"},
    {U'g', 7, "59 53|~59 52 50 10 01|@03 53 59 09"},
    {U'h', 7, "0c 03|~06 09 59 57 53|57 53"},
    {U'i', 3, "19 13|1b 1c"},
    {U'j', 4, "~29 22 20 10 00|29 23|2b 2c"},
    {U'k', 6, "0c 03|05 49|16 43"},
    {U'l', 4, "~1c 14 13 33|1c 15"},
    {U'm', 10, "09 03|~06 09 49 47 43|47 43|~46 49 89 87 83|87 83"},
    {U'n', 7, "09 03|~06 09 59 57 53|57 53"},
    {U'o', 7, "@03 53 59 09"},
    {U'p', 7, "09 00|@03 53 59 09"},
    {U'q', 7, "59 50|@03 53 59 09"},
    {U'r', 5, "09 03|~06 09 39 48"},
    {U's', 6, "~48 49 09 06 36 56 43 13 04"},
    {U't', 5, "~1c 15 13 43|1c 15|09 39"},
    {U'u', 7, "~09 05 03 53 56|09 05|59 53"},
    {U'v', 7, "09 33 69"},
    {U'w', 9, "09 23 48 63 89"},
    {U'x', 6, "03 59|09 53"},
    {U'y', 7, "09 33|69 20 00"},
    {U'z', 6, "09 59 03 53"},
    {U'.', 3, "13 13"},
    {U',', 3, "13 02"},
    {U':', 3, "14 14|18 18"},
    {U';', 3, "13 02|18 18"},
    {U'-', 6, "17 47"},
    {U'+', 8, "17 67|4a 44"},
    {U'=', 8, "16 66|19 69"},
    {U'/', 6, "02 5d"},
    {U'(', 4, "~3d 1b 14 32"},
    {U')', 4, "~0d 2b 24 02"},
    {U'[', 4, "3d 1d 12 32"},
    {U']', 4, "0d 2d 22 02"},
    {U'<', 7, "5b 08 55"},
    {U'>', 7, "0b 58 05"},
    {U'%', 9, "13 7c|@18 38 3c 0c|@53 83 87 57"},
    {U'*', 6, "2c 28|0b 49|09 4b"},
    {U'_', 7, "02 62"},
    {U'\'', 3, "1c 1a"},
    {U'"', 5, "1c 1a|3c 3a"},
    {U'!', 3, "1c 16|13 13"},
    {U'?', 6, "~0b 0c 4c 4a 48 28 26|23 23"},
    {U'|', 3, "12 1d"},
    {U'\u2212', 8, "17 67"},
    {U'\u2013', 7, "07 67"},
    {U'\u00d7', 7, "15 5a|1a 55"},
    {U'\u00b7', 3, "17 17"},
    {U'\u00b0', 5, "@19 39 3c 0c"},
    {U'\u00b2', 4, "~0b 0c 3c 3b 2a 08 08|08 38"},
    {U'\u00b3', 4, "~0c 3c 3a 1a|~1a 3a 38 08"},
    {U'\u00b1', 8, "18 68|4b 45|13 63"},
    {U'\u2264', 7, "5c 09 56|03 53"},
    {U'\u2265', 7, "0c 59 06|03 53"},
    {U'\u00b5', 7, "09 00|~09 05 03 53 56|59 53"},
});

constexpr Glyph kUnknown{0, 7, "03 53 5c 0c 03"};

const Glyph& glyph_of(char32_t character) {
  const auto found = std::ranges::find(kGlyphs, character, &Glyph::character);
  return found == kGlyphs.end() ? kUnknown : *found;
}

// Calls f with each character of well-formed UTF-8; malformed bytes are unknown characters.
template <typename F>
void decode(std::string_view text, F f) {
  for (std::size_t i = 0; i < text.size();) {
    const auto lead = static_cast<unsigned char>(text[i++]);
    const int more = lead < 0x80 ? 0 : lead < 0xc0 ? 0 : lead < 0xe0 ? 1 : lead < 0xf0 ? 2 : 3;
    char32_t c = more == 0 ? lead : lead & (0x3fU >> more);
    for (int k = 0; k < more && i < text.size(); ++k) c = c << 6 | (static_cast<unsigned char>(text[i++]) & 0x3fU);
    f(c);
  }
}

Point2 middle(Point2 a, Point2 b) { return {(a.x + b.x) / 2, (a.y + b.y) / 2}; }

// The quadratic piece from a to c with control point b, without a.
void bend(Point2 a, Point2 b, Point2 c, std::vector<Point2>& out) {
  constexpr int kPieces = 6;
  for (int i = 1; i <= kPieces; ++i) {
    const double t = static_cast<double>(i) / kPieces, s = 1 - t;
    out.push_back({s * s * a.x + 2 * s * t * b.x + t * t * c.x, s * s * a.y + 2 * s * t * b.y + t * t * c.y});
  }
}

std::vector<Point2> curve(const std::vector<Point2>& control, char kind) {
  std::vector<Point2> out;
  const std::size_t n = control.size();
  if (kind == '@') {
    out.push_back(middle(control[n - 1], control[0]));
    for (std::size_t i = 0; i < n; ++i) bend(out.back(), control[i], middle(control[i], control[(i + 1) % n]), out);
  } else {
    out.push_back(control[0]);
    for (std::size_t i = 1; i + 1 < n; ++i)
      bend(out.back(), control[i], i + 2 < n ? middle(control[i], control[i + 1]) : control[i + 1], out);
  }
  return out;
}

double unit(char c) { return c <= '9' ? c - '0' : c - 'a' + 10; }

}  // namespace

std::vector<std::vector<Point2>> strokes(std::string_view words, double size) {
  const double scale = size / kCapital;
  std::vector<std::vector<Point2>> all;
  double pen = 0;
  decode(words, [&](char32_t character) {
    const Glyph& glyph = glyph_of(character);
    for (std::string_view rest = glyph.strokes; !rest.empty();) {
      const std::size_t end = std::min(rest.find('|'), rest.size());
      std::string_view points = rest.substr(0, end);
      rest.remove_prefix(std::min(end + 1, rest.size()));
      const char kind = points.front();
      if (kind == '~' || kind == '@') points.remove_prefix(1);
      std::vector<Point2> path;
      for (std::size_t i = 0; i + 1 < points.size(); i += 3)
        path.push_back({(pen + unit(points[i])) * scale, (3 - unit(points[i + 1])) * scale});
      all.push_back(kind == '~' || kind == '@' ? curve(path, kind) : path);
    }
    pen += glyph.advance + 1.2;
  });
  return all;
}

double stroke_width(double size) { return std::max(1.0, 0.125 * size); }

double text_width(std::string_view words, double size) {
  double pen = 0;
  decode(words, [&](char32_t character) { pen += glyph_of(character).advance + 1.2; });
  return std::max(0.0, pen - 2.2) * size / kCapital;
}

}  // namespace spherule
