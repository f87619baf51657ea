// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/options.h"

#include <algorithm>
#include <array>

#include "core/base/option_values.h"
#include "core/base/ranges.h"
#include "core/base/text.h"

namespace spherule {
namespace {

[[noreturn]] void refuse(std::string_view name, const std::string& detail) { detail::refuse_option(name, detail); }

using spherule::text_of;
std::string text_of(Vec3 v) { return text_of(v.x) + ',' + text_of(v.y) + ',' + text_of(v.z); }

std::vector<double> numbers(std::string_view name, std::string_view text, std::size_t least, std::size_t most) {
  std::vector<double> values;
  for (const std::string_view part : split(text, ',')) {
    const auto value = number_in<double>(part);
    if (!value || values.size() == most) values.clear(), values.resize(most + 1);
    if (values.size() > most) break;
    values.push_back(*value);
  }
  if (values.size() < least || values.size() > most)
    refuse(name, least == most ? "Give " + text_of(least) + " numbers with commas between."
                               : "Give " + text_of(least) + " or " + text_of(most) + " numbers with commas between.");
  return values;
}
Vec3 triple(std::string_view name, std::string_view text) {
  const auto v = numbers(name, text, 3, 3);
  return {v[0], v[1], v[2]};
}

// How a kind of value is read and written.
void read(std::string_view name, std::string_view text, int& value) {
  const auto number = number_in<int>(text);
  if (!number) refuse(name, "Give a whole number.");
  value = *number;
}
void read(std::string_view name, std::string_view text, double& value) {
  const auto number = number_in<double>(text);
  if (!number) refuse(name, "Give a number.");
  value = *number;
}
void read(std::string_view name, std::string_view text, bool& value) {
  if (text != "true" && text != "false") refuse(name, "Give true or false.");
  value = text == "true";
}
std::string write(int value) { return text_of(value); }
std::string write(double value) { return text_of(value); }
std::string write(bool value) { return value ? "true" : "false"; }

// Words of enumerations, in the order of the enumerators.
template <typename E>
constexpr std::span<const std::string_view> words();
#define SPHERULE_WORDS(type, ...)                                                     \
  constexpr std::array k##type##Words = std::to_array<std::string_view>(__VA_ARGS__); \
  template <>                                                                         \
  constexpr std::span<const std::string_view> words<type>() {                         \
    return k##type##Words;                                                            \
  }
SPHERULE_WORDS(Style, {"spheres", "blobs", "tetrahedra", "surface", "points", "centres"})
SPHERULE_WORDS(ColourBy, {"none", "radius", "contribution", "component", "cluster", "curvature"})
SPHERULE_WORDS(Background, {"transparent", "white", "dark", "gradient"})
SPHERULE_WORDS(Projection, {"orthographic", "perspective"})
SPHERULE_WORDS(Layout, {"beside", "overlaid"})
SPHERULE_WORDS(Overlay, {"contour", "points", "triangles", "inside", "circles", "centres"})
#undef SPHERULE_WORDS

template <typename E>
requires std::is_enum_v<E>
void read(std::string_view name, std::string_view text, E& value) {
  const auto found = std::ranges::find(words<E>(), text);
  if (found == words<E>().end()) refuse(name, "Give one of " + listed(words<E>()) + ".");
  value = static_cast<E>(found - words<E>().begin());
}
template <typename E>
requires std::is_enum_v<E> std::string write(E value) {
  return std::string(words<E>()[static_cast<std::size_t>(value)]);
}

View view_of(std::string_view name, std::string_view text) {
  if (text.size() != 1 || std::string_view("aprlhf").find(text[0]) == std::string_view::npos)
    refuse(name, "Give one of a, p, r, l, h, f.");
  return static_cast<View>(text[0]);
}

std::vector<int> buckets_of(std::string_view name, std::string_view text) {
  std::vector<int> buckets;
  for (const std::string_view part : split(text, ',')) {
    const auto ends = split(part, '-');
    const auto first = number_in<int>(ends.front()), last = number_in<int>(ends.back());
    if (ends.size() > 2 || !first || !last || !ranges::bucket.holds(*first) || !ranges::bucket.holds(*last) ||
        *first > *last)
      refuse(name, "Give numbers of buckets and ranges of them, such as 0,3-5.");
    for (int b = *first; b <= *last; ++b) buckets.push_back(b);
  }
  std::ranges::sort(buckets);
  buckets.erase(std::ranges::unique(buckets).begin(), buckets.end());
  return buckets;
}
std::string text_of(const std::vector<int>& buckets) {
  std::string text;
  for (std::size_t i = 0; i < buckets.size();) {
    std::size_t last = i;
    while (last + 1 < buckets.size() && buckets[last + 1] == buckets[last] + 1) ++last;
    text += (text.empty() ? "" : ",") + text_of(buckets[i]);
    if (last > i) text += '-' + text_of(buckets[last]);
    i = last + 1;
  }
  return text;
}

bool by_number(const RenderOptions& o) {
  return o.colour_by == ColourBy::radius || o.colour_by == ColourBy::contribution || o.colour_by == ColourBy::curvature;
}
Viewpoint& viewpoint(RenderOptions& o) {
  return o.camera.viewpoint ? *o.camera.viewpoint : o.camera.viewpoint.emplace();
}
Window& window(SliceOptions& o) { return o.window ? *o.window : o.window.emplace(); }

// One option: how its text is read, how it is written (empty: it is not set), and when it matters.
template <typename Options>
struct Option {
  std::string_view name;
  void (*set)(Options&, std::string_view name, std::string_view text);
  std::string (*get)(const Options&);
  bool (*matters)(const Options&) = [](const Options&) { return true; };
  const char* when = "";
};

#define SPHERULE_FIELD(field)                                                               \
  [](auto& o, std::string_view name, std::string_view text) { read(name, text, o.field); }, \
      [](const auto& o) { return write(o.field); }
#define SPHERULE_WHEN(condition, sentence) [](const auto& o) { return condition; }, sentence

constexpr auto kRenderOptions = std::to_array<Option<RenderOptions>>({
    {"style", SPHERULE_FIELD(style)},
    {"smoothness", SPHERULE_FIELD(smoothness), SPHERULE_WHEN(o.style == Style::blobs, "This is for style=blobs.")},
    {"point_radius", SPHERULE_FIELD(point_radius_mm),
     SPHERULE_WHEN(o.style == Style::points || o.style == Style::centres, "This is for style=points or centres.")},
    {"min_radius", SPHERULE_FIELD(min_radius_mm)},
    {"max_radius",
     [](RenderOptions& o, std::string_view name, std::string_view text) {
       read(name, text, o.max_radius_mm.emplace());
     },
     [](const RenderOptions& o) { return o.max_radius_mm ? write(*o.max_radius_mm) : std::string(); }},
    {"buckets",
     [](RenderOptions& o, std::string_view name, std::string_view text) { o.buckets = buckets_of(name, text); },
     [](const RenderOptions& o) { return text_of(o.buckets); }},
    {"bucket_count", SPHERULE_FIELD(bucket_count), SPHERULE_WHEN(!o.buckets.empty(), "This is for buckets.")},
    {"width", SPHERULE_FIELD(width)},
    {"height", SPHERULE_FIELD(height)},
    {"samples", SPHERULE_FIELD(samples_per_axis)},
    {"background", SPHERULE_FIELD(background)},
    {"view", [](RenderOptions& o, std::string_view name, std::string_view text) { o.views = {view_of(name, text)}; },
     [](const RenderOptions& o) {
       return o.views.size() == 1 ? std::string(1, static_cast<char>(o.views.front())) : std::string();
     },
     SPHERULE_WHEN(!o.camera.viewpoint, "Give a view or a position.")},
    {"views",
     [](RenderOptions& o, std::string_view name, std::string_view text) {
       o.views.clear();
       for (const std::string_view part : split(text, ',')) o.views.push_back(view_of(name, part));
     },
     [](const RenderOptions& o) {
       std::string list;
       if (o.views.size() == 1) return list;
       for (const View v : o.views) list += (list.empty() ? "" : ",") + std::string(1, static_cast<char>(v));
       return list;
     },
     SPHERULE_WHEN(!o.camera.viewpoint, "Give views or a position.")},
    {"position",
     [](RenderOptions& o, std::string_view name, std::string_view text) { viewpoint(o).position = triple(name, text); },
     [](const RenderOptions& o) { return o.camera.viewpoint ? text_of(o.camera.viewpoint->position) : std::string(); }},
    {"look_at",
     [](RenderOptions& o, std::string_view name, std::string_view text) { viewpoint(o).look_at = triple(name, text); },
     [](const RenderOptions& o) {
       return o.camera.viewpoint && o.camera.viewpoint->look_at ? text_of(*o.camera.viewpoint->look_at) : std::string();
     }},
    {"up", [](RenderOptions& o, std::string_view name, std::string_view text) { viewpoint(o).up = triple(name, text); },
     [](const RenderOptions& o) {
       return o.camera.viewpoint && o.camera.viewpoint->up ? text_of(*o.camera.viewpoint->up) : std::string();
     }},
    {"fit", SPHERULE_FIELD(camera.fit), SPHERULE_WHEN(o.camera.viewpoint.has_value(), "This is for a position.")},
    {"projection", SPHERULE_FIELD(camera.projection)},
    {"field_of_view", SPHERULE_FIELD(camera.field_of_view),
     SPHERULE_WHEN(o.camera.projection == Projection::perspective || (o.camera.viewpoint && !o.camera.fit),
                   "This is for projection=perspective, or a position.")},
    {"clip",
     [](RenderOptions& o, std::string_view name, std::string_view text) {
       const auto v = numbers(name, text, 3, 4);
       o.clip_normal = Vec3{v[0], v[1], v[2]};
       if (v.size() == 4) o.clip_offset_mm = v[3];
     },
     [](const RenderOptions& o) {
       if (!o.clip_normal) return std::string();
       return text_of(*o.clip_normal) + (o.clip_offset_mm ? ',' + text_of(*o.clip_offset_mm) : std::string());
     }},
    {"turntable", SPHERULE_FIELD(turntable)},
    {"layout", SPHERULE_FIELD(layout)},
    {"shadows", SPHERULE_FIELD(shadows)},
    {"ambient_occlusion", SPHERULE_FIELD(ambient_occlusion)},
    {"opacity", SPHERULE_FIELD(opacity)},
    {"colour_by", SPHERULE_FIELD(colour_by)},
    {"colour_map", [](RenderOptions& o, std::string_view, std::string_view text) { o.colour_map = text; },
     [](const RenderOptions& o) { return o.colour_map; },
     SPHERULE_WHEN(by_number(o), "This is for colour_by=radius, contribution or curvature.")},
    {"colour_range",
     [](RenderOptions& o, std::string_view name, std::string_view text) {
       const auto v = numbers(name, text, 2, 2);
       o.colour_range = std::array{v[0], v[1]};
     },
     [](const RenderOptions& o) {
       return o.colour_range ? text_of((*o.colour_range)[0]) + ',' + text_of((*o.colour_range)[1]) : std::string();
     },
     SPHERULE_WHEN(by_number(o), "This is for colour_by=radius, contribution or curvature.")},
    {"legend", SPHERULE_FIELD(legend),
     SPHERULE_WHEN(by_number(o), "This is for colour_by=radius, contribution or curvature.")},
    {"marker", SPHERULE_FIELD(orientation_marker)},
    {"scale_bar", SPHERULE_FIELD(scale_bar)},
});

constexpr auto kSliceOptions = std::to_array<Option<SliceOptions>>({
    {"width", SPHERULE_FIELD(width)},
    {"height", SPHERULE_FIELD(height)},
    {"window", [](SliceOptions& o, std::string_view name, std::string_view text) { read(name, text, window(o).width); },
     [](const SliceOptions& o) { return o.window ? write(o.window->width) : std::string(); },
     SPHERULE_WHEN(o.image, "This is for image=true.")},
    {"level", [](SliceOptions& o, std::string_view name, std::string_view text) { read(name, text, window(o).level); },
     [](const SliceOptions& o) { return o.window ? write(o.window->level) : std::string(); },
     SPHERULE_WHEN(o.image, "This is for image=true.")},
    {"smooth", SPHERULE_FIELD(smooth), SPHERULE_WHEN(o.image, "This is for image=true.")},
    {"image", SPHERULE_FIELD(image)},
    {"region",
     [](SliceOptions& o, std::string_view name, std::string_view text) {
       const auto v = numbers(name, text, 4, 4);
       o.region = std::array{v[0], v[1], v[2], v[3]};
     },
     [](const SliceOptions& o) {
       std::string list;
       if (o.region)
         for (const double v : *o.region) list += (list.empty() ? "" : ",") + text_of(v);
       return list;
     }},
    {"show",
     [](SliceOptions& o, std::string_view name, std::string_view text) {
       o.show.clear();
       for (const std::string_view part : split(text, ',')) read(name, part, o.show.emplace_back());
       std::ranges::sort(o.show);
       o.show.erase(std::ranges::unique(o.show).begin(), o.show.end());
     },
     [](const SliceOptions& o) {
       std::string list;
       for (const Overlay what : o.show) list += (list.empty() ? "" : ",") + write(what);
       return list;
     }},
    {"letters", SPHERULE_FIELD(letters)},
    {"scale_bar", SPHERULE_FIELD(scale_bar)},
    {"caption", SPHERULE_FIELD(caption)},
});
#undef SPHERULE_FIELD
#undef SPHERULE_WHEN

template <const auto& table>
constexpr auto names_in = [] {
  std::array<std::string_view, table.size()> names;
  std::ranges::transform(table, names.begin(), [](const auto& option) { return option.name; });
  return names;
}();

bool is_given(const OptionTexts& given, std::string_view name) {
  return std::ranges::any_of(given, [&](const auto& pair) { return pair.first == name; });
}

template <typename Options, std::size_t n>
Options parsed(const std::array<Option<Options>, n>& table, const OptionTexts& given) {
  Options options;
  for (auto it = given.begin(); it != given.end(); ++it) {
    const auto& [name, text] = *it;
    const auto option = std::ranges::find(table, std::string_view(name), &Option<Options>::name);
    if (option == table.end()) refuse(name.substr(0, 100), "There is no such option.");
    if (std::any_of(given.begin(), it, [&](const auto& other) { return other.first == name; }))
      refuse(name, "Give this option once.");
    option->set(options, option->name, text);
  }
  for (const auto& option : table)
    if (is_given(given, option.name) && !option.matters(options)) refuse(option.name, option.when);
  return options;
}

template <typename Options, std::size_t n>
OptionTexts texts_of(const std::array<Option<Options>, n>& table, const Options& options) {
  OptionTexts texts;
  for (const auto& option : table) {
    if (!option.matters(options)) continue;
    if (std::string text = option.get(options); !text.empty()) texts.emplace_back(option.name, std::move(text));
  }
  return texts;
}

}  // namespace

std::span<const std::string_view> render_option_names() { return names_in<kRenderOptions>; }

RenderOptions parse_render_options(const OptionTexts& given) {
  const RenderOptions options = parsed(kRenderOptions, given);
  if (is_given(given, "view") && is_given(given, "views")) refuse("views", "Give a view or views.");
  for (const std::string_view name : {"look_at", "up"})
    if (is_given(given, name) && !is_given(given, "position")) refuse(name, "This is for a position.");
  return options;
}

OptionTexts render_option_texts(const RenderOptions& options) { return texts_of(kRenderOptions, options); }

std::span<const std::string_view> slice_option_names() { return names_in<kSliceOptions>; }

SliceOptions parse_slice_options(const OptionTexts& given) {
  const SliceOptions options = parsed(kSliceOptions, given);
  if (is_given(given, "window") != is_given(given, "level"))
    refuse(is_given(given, "window") ? "level" : "window", "Give window and level together.");
  return options;
}

OptionTexts slice_option_texts(const SliceOptions& options) { return texts_of(kSliceOptions, options); }

}  // namespace spherule
