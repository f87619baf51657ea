// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/requests.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>

#include "api/http/problem.h"
#include "api/json/documents.h"
#include "api/json/label_json.h"
#include "core/render/options.h"

namespace spherule::api {

namespace {

[[noreturn]] void refuse(std::string_view pointer, const std::string& detail) {
  throw Error(ErrorCode::invalid_argument, "Correct the parameters listed under errors.",
              {{std::string(pointer), detail}});
}

std::string_view trimmed(std::string_view s) {
  while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
  while (!s.empty() && (s.back() == ' ' || s.back() == '\t')) s.remove_suffix(1);
  return s;
}

std::string lower(std::string_view s) {
  std::string out(s);
  std::ranges::transform(out, out.begin(), [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
  return out;
}

// Calls f with each trimmed, non-empty piece between separators.
template <typename F>
void split(std::string_view s, char separator, F&& f) {
  while (!s.empty()) {
    const std::size_t end = std::min(s.find(separator), s.size());
    if (const std::string_view piece = trimmed(s.substr(0, end)); !piece.empty()) f(piece);
    s.remove_prefix(std::min(end + 1, s.size()));
  }
}

template <typename T>
std::optional<T> parse_number(std::string_view s) {
  T value{};
  const auto [end, error] = std::from_chars(s.data(), s.data() + s.size(), value);
  if (error != std::errc{} || end != s.data() + s.size()) return std::nullopt;
  return value;
}

std::string joined(std::span<const std::string_view> words) {
  std::string out;
  for (const std::string_view word : words) out += (out.empty() ? "" : ", ") + std::string(word);
  return out;
}

using Json = nlohmann::json;

constexpr int kMostFields = 100;

// The JSON object that a body holds; `example` is one.
Json object_in(std::string_view text, const std::string& example) {
  Json json;
  int fields = 0;
  try {
    // Requests are three levels deep at most; deeper text is refused before it can exhaust the stack, and so is one of
    // far more fields than any request has, before each is remembered and told of.
    json = Json::parse(text, [&](int depth, Json::parse_event_t event, Json& part) {
      if (depth > 8) throw Error(ErrorCode::malformed, "The body is nested too deeply; send a JSON object.");
      if (event == Json::parse_event_t::key && ++fields > kMostFields) {
        throw Error(ErrorCode::malformed, "The body has more than " + std::to_string(kMostFields) +
                                              " fields; send an object such as " + example + ".");
      }
      // Names are repeated in sentences, which a zero byte would end.
      if (event == Json::parse_event_t::key && part.get_ref<const std::string&>().find('\0') != std::string::npos) {
        throw Error(ErrorCode::malformed, "The body has a field with a zero byte in its name; send no such field.");
      }
      return true;
    });
  } catch (const Json::exception&) {
    throw Error(ErrorCode::malformed, "The body is not JSON; send an object such as " + example + ".");
  }
  if (!json.is_object()) {
    throw Error(ErrorCode::invalid_argument, "Send a JSON object such as " + example + ".");
  }
  return json;
}

// RFC 6901.
std::string pointer_to(std::string_view key) {
  std::string pointer = "/";
  for (const char c : key.substr(0, 100)) pointer += c == '~' ? "~0" : c == '/' ? "~1" : std::string(1, c);
  return pointer;
}

}  // namespace

bool is_utf8(std::string_view s) {
  const auto byte = [&](std::size_t i) { return i < s.size() ? static_cast<unsigned char>(s[i]) : 0; };
  for (std::size_t i = 0; i < s.size();) {
    const unsigned lead = byte(i), second = byte(i + 1);
    const std::size_t length = lead < 0x80   ? 1
                               : lead < 0xc2 ? 0
                               : lead < 0xe0 ? 2
                               : lead < 0xf0 ? 3
                               : lead < 0xf5 ? 4
                                             : 0;
    // Overlong forms, surrogates, and what lies beyond Unicode.
    const bool wrong = (lead == 0xe0 && second < 0xa0) || (lead == 0xed && second > 0x9f) ||
                       (lead == 0xf0 && second < 0x90) || (lead == 0xf4 && second > 0x8f);
    if (length == 0 || wrong) return false;
    for (std::size_t k = 1; k < length; ++k) {
      if ((byte(i + k) & 0xc0) != 0x80) return false;
    }
    i += length;
  }
  return true;
}

Query::Query(const Request& request, std::span<const std::string_view> known) : request_(request) {
  std::vector<FieldError> errors;
  for (auto it = request.query.begin(); it != request.query.end(); ++it) {
    const std::string& name = it->first;
    if (std::ranges::find(known, name) == known.end()) {
      errors.push_back(
          {name.substr(0, 100), known.empty() ? "This resource takes no parameters."
                                              : "There is no such parameter here; known are " + joined(known) + "."});
    } else if (std::any_of(request.query.begin(), it, [&](const auto& other) { return other.first == name; })) {
      errors.push_back({name, "Give this parameter once."});
    } else if (!is_utf8(it->second)) {
      errors.push_back({name, "Give this parameter in UTF-8."});
    }
  }
  if (!errors.empty()) {
    throw Error(ErrorCode::invalid_argument, "Correct the parameters listed under errors.", std::move(errors));
  }
}

std::optional<std::string> Query::text(std::string_view name) const {
  const auto found = std::ranges::find_if(request_.query, [&](const auto& pair) { return pair.first == name; });
  if (found == request_.query.end()) return std::nullopt;
  return found->second;
}

std::optional<std::int64_t> Query::integer(std::string_view name, const ranges::Whole& range) const {
  const auto given = text(name);
  if (!given) return std::nullopt;
  const auto value = parse_number<std::int64_t>(*given);
  if (!value || !range.holds(*value)) refuse(name, "Give a whole number " + range.words() + ".");
  return value;
}

std::optional<std::vector<double>> Query::numbers(std::string_view name, std::size_t count,
                                                  const ranges::Real& range) const {
  const auto given = text(name);
  if (!given) return std::nullopt;
  std::vector<double> values;
  bool good = !given->empty() && given->back() != ',';
  for (std::string_view rest = *given; good && !rest.empty();) {
    const std::size_t end = std::min(rest.find(','), rest.size());
    const auto value = parse_number<double>(trimmed(rest.substr(0, end)));
    good = value && range.holds(*value) && values.size() < count;
    if (good) values.push_back(*value);
    rest.remove_prefix(std::min(end + 1, rest.size()));
  }
  if (!good || values.size() != count) {
    refuse(name, count == 1
                     ? "Give a number " + range.words() + "."
                     : "Give " + std::to_string(count) + " numbers with commas between, each " + range.words() + ".");
  }
  return values;
}

std::optional<std::string> Query::choice(std::string_view name, std::initializer_list<std::string_view> choices) const {
  const auto given = text(name);
  if (given && std::ranges::find(choices, *given) == choices.end())
    refuse(name, "Give one of " + joined({choices.begin(), choices.size()}) + ".");
  return given;
}

PageRequest page_request(const Query& query) {
  return {.limit = static_cast<std::size_t>(query.integer("limit", ranges::page).value_or(100)),
          .cursor = query.text("cursor").value_or("")};
}

SphereListing sphere_listing(const Query& query) {
  SphereListing listing;
  const std::string columns = query.text("columns").value_or("");
  split(columns, ',', [&](std::string_view word) {
    const auto figure = std::ranges::find(sphere_figures, word, [](SphereFigure f) { return name(f); });
    if (figure == sphere_figures.end()) {
      std::string known;
      for (const SphereFigure f : sphere_figures) known += (known.empty() ? "" : ", ") + std::string(name(f));
      refuse("columns", "Give names out of " + known + ", with commas between; x, y, z and r are always there.");
    }
    if (std::ranges::find(listing.columns, *figure) != listing.columns.end()) {
      refuse("columns", "Name every column once.");
    }
    listing.columns.push_back(*figure);
  });
  if (query.choice("order", {"index", "contribution"}) == "contribution") listing.order = SphereOrder::contribution;
  const auto rows = query.choice("rows", {"spheres", "nodes", "members"});
  if (rows == "nodes") listing.rows = SphereRows::nodes;
  if (rows == "members") listing.rows = SphereRows::members;
  using enum SphereFigure;
  if (!query.text("columns") && listing.rows == SphereRows::nodes) {
    listing.columns = {node, parent, level_from, level_to, members};
  }
  if (!query.text("columns") && listing.rows == SphereRows::members) listing.columns = {cluster};
  if (listing.rows != SphereRows::spheres && listing.order != SphereOrder::index) {
    refuse("order", "Rows that are nodes or members come by index; leave order out.");
  }
  for (const SphereFigure figure : listing.columns) {
    if (listing.rows == SphereRows::members ? figure != index && figure != cluster
                                            : figure == cluster || (listing.rows == SphereRows::nodes &&
                                                                    (is_contribution(figure) || figure == index))) {
      refuse("columns", "There is no " + std::string(name(figure)) +
                            " of such rows: of members there are index and "
                            "cluster, of nodes node, parent, level_from, level_to and members, of spheres all but "
                            "cluster.");
    }
  }
  if (listing.rows == SphereRows::nodes && query.text("level")) {
    refuse("level", "Nodes are of all levels; leave level out.");
  }
  return listing;
}

std::vector<std::uint32_t> tree_levels(const Query& query) {
  std::vector<std::uint32_t> levels;
  const auto given = query.text("levels");
  if (!given) return levels;
  split(*given, ',', [&](std::string_view word) {
    const auto level = parse_number<std::uint32_t>(word);
    if (!level || !ranges::level.holds(*level) || levels.size() == 1000 ||
        (!levels.empty() && *level <= levels.back())) {
      refuse("levels", "Give ascending whole numbers above zero with commas between, at most 1000.");
    }
    levels.push_back(*level);
  });
  if (levels.empty()) refuse("levels", "Give at least one level, such as 1,8,64.");
  return levels;
}

std::vector<std::string> upload_ids(const Request& request) {
  std::vector<std::string> ids;
  for (const auto& [name, value] : request.query) {
    if (name != "upload") continue;
    split(value, ',', [&](std::string_view id) { ids.emplace_back(id); });
    if (ids.empty()) refuse("upload", "Give the ids of finished uploads, with commas between.");
  }
  return ids;
}

VolumeParameters volume_parameters(const Request& request) {
  const Query query(request, {"format", "dims", "dtype", "spacing", "origin", "endian", "frame", "grid", "upload"});
  VolumeParameters parameters;
  if (query.choice("format", {"raw"})) {
    RawLayout raw;
    const ranges::Real sizes{static_cast<double>(ranges::dim.least), static_cast<double>(ranges::dim.most)};
    const auto dims = query.numbers("dims", 3, sizes);
    if (!dims) refuse("dims", "Raw samples need their sizes: dims=nx,ny,nz.");
    for (std::size_t a = 0; a < 3; ++a) {
      const double n = (*dims)[a];
      if (n != std::floor(n)) refuse("dims", "Every size must be a whole number above zero.");
      raw.dims[a] = static_cast<std::int32_t>(n);
    }
    const auto dtype = query.text("dtype");
    if (!dtype) refuse("dtype", "Raw samples need their type, by NumPy's name: dtype=uint8.");
    try {
      raw.type = voxel_type(*dtype);
    } catch (const Error& error) {
      refuse("dtype", error.what());
    }
    if (const auto spacing = query.numbers("spacing", 3, ranges::spacing_mm))
      raw.spacing = {(*spacing)[0], (*spacing)[1], (*spacing)[2]};
    if (const auto origin = query.numbers("origin", 3, ranges::origin_mm))
      raw.origin = {(*origin)[0], (*origin)[1], (*origin)[2]};
    raw.big_endian = query.choice("endian", {"little", "big"}) == "big";
    parameters.raw = raw;
  } else {
    for (const std::string_view name : {"dims", "dtype", "spacing", "origin", "endian"}) {
      if (query.text(name)) refuse(name, "This parameter describes headerless samples; add format=raw.");
    }
  }
  if (const auto frame = query.integer("frame", ranges::index)) parameters.frame = static_cast<int>(*frame);
  parameters.grid = query.text("grid").value_or("");
  if (parameters.raw && (parameters.frame || !parameters.grid.empty())) {
    refuse(parameters.frame ? "frame" : "grid", "Headerless samples are one volume; leave this parameter out.");
  }
  return parameters;
}

std::pair<RenderRequest, std::uint32_t> render_request(const Request& request) {
  std::vector<std::string_view> known(render_option_names().begin(), render_option_names().end());
  known.push_back("with");
  known.push_back("level");
  const Query query(request, known);
  RenderRequest wanted;
  wanted.with = query.text("with").value_or("");
  OptionTexts given = request.query;
  std::erase_if(given, [](const auto& pair) { return pair.first == "with" || pair.first == "level"; });
  wanted.options = parse_render_options(given);
  if (wanted.with.empty() && query.text("layout")) refuse("layout", "This is for a second model: with=mdl_….");
  check_render_options(wanted.options);
  return {wanted, static_cast<std::uint32_t>(query.integer("level", ranges::level).value_or(0))};
}

std::string query_of(const RenderRequest& request) {
  OptionTexts texts = render_option_texts(request.options);
  const OptionTexts usual = render_option_texts({});
  std::erase_if(texts, [&](const auto& text) { return std::ranges::find(usual, text) != usual.end(); });
  if (!request.with.empty()) texts.emplace_back("with", request.with);
  std::string query;
  for (const auto& [name, text] : texts) query += (query.empty() ? "?" : "&") + name + "=" + text;
  return query;
}

namespace {

// In the order of FigureFormat.
constexpr std::array<std::string_view, 3> kFigureWords = {"json", "png", "svg"};
constexpr std::array<std::string_view, 3> kFigureTypes = {"application/json", "image/png", "image/svg+xml"};
constexpr auto kRuleNames = std::to_array<std::string_view>({"threshold", "range", "labels", "inside", "border"});

std::string text_of(double value) {
  std::array<char, 32> text;
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), value + 0.0).ptr};  // -0 is 0
}

std::vector<Label> labels_of(std::string_view text) {
  std::vector<Label> labels;
  bool good = true;
  split(text, ',', [&](std::string_view word) {
    const auto label = parse_label(word);
    good = good && label && labels.size() < 65536;
    if (good) labels.push_back(*label);
  });
  if (!good || labels.empty()) refuse("labels", "Give whole numbers with commas between.");
  std::ranges::sort(labels);
  labels.erase(std::ranges::unique(labels).begin(), labels.end());
  return labels;
}

// Numbers, or strings of digits, which keep what a client's floating numbers would round. None unless all are right.
std::vector<Label> labels_in(const Json& array) {
  std::vector<Label> labels;
  if (!array.is_array() || array.size() > 65536) return {};
  for (const Json& j : array) {
    const std::optional<Label> label = j.is_string() ? parse_label(j.get_ref<const std::string&>()) : label_from(j);
    if (!label) return {};
    labels.push_back(*label);
  }
  std::ranges::sort(labels);
  labels.erase(std::ranges::unique(labels).begin(), labels.end());
  return labels;
}

}  // namespace

FigureFormat figure_format(const Request& request, const Query& query, std::span<const FigureFormat> order) {
  FigureFormat asked;
  if (const auto word = query.choice("format", {"json", "png", "svg"})) {
    asked = static_cast<FigureFormat>(std::ranges::find(kFigureWords, *word) - kFigureWords.begin());
    order = std::span(&asked, 1);
  }
  std::vector<std::string_view> types;
  for (const FigureFormat format : order) types.push_back(media_type(format));
  return order[negotiate(request.header("Accept"), types)];
}

std::string_view media_type(FigureFormat format) { return kFigureTypes[static_cast<std::size_t>(format)]; }

std::optional<ObjectRule> object_rule(const Query& query, Side natural) {
  const auto threshold = query.numbers("threshold", 1, ranges::value);
  const auto range = query.numbers("range", 2, ranges::value);
  const auto labels = query.text("labels");
  const auto inside = query.choice("inside", {"above", "below"}), border = query.choice("border", {"closed", "open"});
  const int objects = (threshold ? 1 : 0) + (range ? 1 : 0) + (labels ? 1 : 0);
  if (objects > 1) refuse(threshold ? "threshold" : "range", "Give one of threshold, range and labels.");
  if (objects == 0) {
    if (inside || border)
      refuse(inside ? "inside" : "border", "This is for an object; give threshold, range or labels.");
    return std::nullopt;
  }
  ObjectRule rule;
  if (threshold) {
    rule.lo = threshold->front();
    rule.side = natural;
  } else if (range) {
    rule.kind = ObjectRule::Kind::range;
    rule.lo = range->front(), rule.hi = range->back();
    if (rule.lo > rule.hi) refuse("range", "Give two numbers lo,hi with lo no greater than hi.");
  } else {
    rule.kind = ObjectRule::Kind::labels;
    rule.labels = labels_of(*labels);
  }
  if (inside) rule.side = *inside == "below" ? Side::below : Side::above;
  if (border == "open") rule.border = Border::open;
  return rule;
}

SliceRequest slice_request(const Request& request, const VolumeInfo& volume, std::string_view axis,
                           std::string_view index) {
  std::vector<std::string_view> known(kRuleNames.begin(), kRuleNames.end());
  known.push_back("format");
  known.insert(known.end(), slice_option_names().begin(), slice_option_names().end());
  const Query query(request, known);
  SliceRequest wanted;
  if (axis.size() != 1 || axis[0] < 'i' || axis[0] > 'k')
    throw Error(ErrorCode::not_found, "There is no such axis; slices are numbered along the grid's axes i, j and k.");
  wanted.axis = axis[0] - 'i';
  const std::int32_t count = volume.grid.dims[static_cast<std::size_t>(wanted.axis)];
  const auto number = parse_number<std::int32_t>(index);
  if (!number || *number < 0 || *number >= count) {
    throw Error(ErrorCode::not_found, "There is no such slice; along " + std::string(axis) +
                                          " the volume has slices 0 to " + std::to_string(count - 1) + ".");
  }
  wanted.index = *number;
  wanted.object = object_rule(query, volume.natural_side);
  constexpr std::array kOrder{FigureFormat::png, FigureFormat::svg, FigureFormat::json};
  wanted.format = figure_format(request, query, kOrder);
  OptionTexts given = request.query;
  std::erase_if(given, [](const auto& pair) {
    return pair.first == "format" || std::ranges::find(kRuleNames, pair.first) != kRuleNames.end();
  });
  const SliceOptions options = parse_slice_options(given);
  check_slice_options(options);
  if (!wanted.object && query.text("show"))
    refuse("show", "Name the object that is shown: threshold, range or labels.");
  if (!wanted.object && !options.image) refuse("image", "Without it only an object can be drawn; name one.");
  // Numbers do not depend on how they could be drawn.
  if (wanted.format != FigureFormat::json) wanted.options = options;
  return wanted;
}

std::string query_of(const SliceRequest& request) {
  OptionTexts texts{{"format", std::string(kFigureWords[static_cast<std::size_t>(request.format)])}};
  if (request.object) {
    const ObjectRule& rule = *request.object;
    switch (rule.kind) {
      case ObjectRule::Kind::threshold: texts.emplace_back("threshold", text_of(rule.lo)); break;
      case ObjectRule::Kind::range: texts.emplace_back("range", text_of(rule.lo) + "," + text_of(rule.hi)); break;
      case ObjectRule::Kind::labels: {
        std::string list;
        for (const Label label : rule.labels) list += (list.empty() ? "" : ",") + to_text(label);
        texts.emplace_back("labels", list);
        break;
      }
    }
    texts.emplace_back("inside", rule.side == Side::above ? "above" : "below");
    if (rule.border == Border::open) texts.emplace_back("border", "open");
  }
  const OptionTexts usual = slice_option_texts({});
  for (const auto& text : slice_option_texts(request.options))
    if (std::ranges::find(usual, text) == usual.end()) texts.push_back(text);
  std::string query;
  for (const auto& [name, text] : texts) query += (query.empty() ? "?" : "&") + name + "=" + text;
  return query;
}

std::pair<FileRequest, std::uint32_t> file_request(const Request& request, FileFormat format) {
  std::vector<std::string_view> known(file_option_names(format).begin(), file_option_names(format).end());
  known.push_back("level");
  const Query query(request, known);
  OptionTexts given = request.query;
  std::erase_if(given, [](const auto& pair) { return pair.first == "level"; });
  return {{format, parse_file_options(format, given)},
          static_cast<std::uint32_t>(query.integer("level", ranges::level).value_or(0))};
}

std::string query_of(const FileRequest& request) {
  std::string query;
  for (const auto& [name, text] : file_option_texts(request.format, request.options)) {
    query += (query.empty() ? "?" : "&") + name + "=" + text;
  }
  return query;
}

ModelWish model_wish(std::string_view text) {
  const Json json = object_in(text, "{\"volume\": id, \"threshold\": 60.5}");
  ModelWish wish;
  std::vector<FieldError> errors;
  int objects = 0;
  const auto is_value = [](const Json& j) { return j.is_number() && ranges::value.holds(j.get<double>()); };
  for (const auto& [key, value] : json.items()) {
    if (key == "volume") {
      if (value.is_string()) {
        wish.volume = value;
      } else {
        errors.push_back({"/volume", "Give the id of a stored volume."});
      }
    } else if (key == "threshold") {
      ++objects;
      if (is_value(value)) {
        wish.rule.lo = value;
      } else {
        errors.push_back({"/threshold", "Give a number " + ranges::value.words() + "."});
      }
    } else if (key == "range") {
      ++objects;
      if (value.is_array() && value.size() == 2 && is_value(value[0]) && is_value(value[1]) && value[0] <= value[1]) {
        wish.rule.kind = ObjectRule::Kind::range;
        wish.rule.lo = value[0];
        wish.rule.hi = value[1];
      } else {
        errors.push_back(
            {"/range", "Give two numbers [lo, hi] " + ranges::value.words() + ", with lo no greater than hi."});
      }
    } else if (key == "labels") {
      ++objects;
      wish.rule.kind = ObjectRule::Kind::labels;
      wish.rule.labels = labels_in(value);
      if (wish.rule.labels.empty()) {
        errors.push_back({"/labels", "Give an array of whole numbers from -2^63 to 2^64 - 1, large ones as strings."});
      }
    } else if (key == "inside") {
      wish.side_given = value == "above" || value == "below";
      wish.rule.side = value == "below" ? Side::below : Side::above;
      if (!wish.side_given) errors.push_back({"/inside", "Give \"above\" or \"below\"."});
    } else if (key == "border") {
      wish.rule.border = value == "open" ? Border::open : Border::closed;
      if (value != "open" && value != "closed") errors.push_back({"/border", "Give \"closed\" or \"open\"."});
    } else {
      errors.push_back(
          {pointer_to(key), "There is no such field; known are volume, threshold, range, labels, inside, border."});
    }
  }
  if (!json.contains("volume")) errors.push_back({"/volume", "Give the id of a stored volume."});
  if (objects != 1) errors.push_back({"", "Give exactly one of threshold, range and labels."});
  if (!errors.empty()) {
    throw Error(ErrorCode::invalid_argument, "Correct the fields listed under errors.", std::move(errors));
  }
  return wish;
}

SimplifyMethod simplify_wish(std::string_view text) {
  const Json json = object_in(text, "{\"method\": \"best\", \"k\": 64}");
  constexpr std::array<std::string_view, 3> words = {"method", "representative", "mode"};
  OptionTexts texts;
  std::vector<FieldError> errors;
  for (const auto& [key, value] : json.items()) {
    const bool known = std::ranges::find(method_option_names(), key) != method_option_names().end();
    if (!known) {
      texts.emplace_back(key, "");  // refused with the others of its kind
    } else if (std::ranges::find(words, key) != words.end()) {
      if (value.is_string()) texts.emplace_back(key, value.get<std::string>());
      if (!value.is_string()) errors.push_back({pointer_to(key), "Give a word."});
    } else if (key == "buckets") {
      const bool good = value.is_array() && !value.empty() && value.size() <= 65536 &&
                        std::ranges::all_of(value, [](const Json& j) { return j.is_number_unsigned(); });
      if (!good) errors.push_back({pointer_to(key), "Give an array of numbers of buckets, counted from 0."});
      std::string list;
      for (const Json& bucket : good ? value : Json()) list += (list.empty() ? "" : ",") + bucket.dump();
      if (good) texts.emplace_back(key, list);
    } else {
      if (value.is_number()) texts.emplace_back(key, value.dump());
      if (!value.is_number()) errors.push_back({pointer_to(key), "Give a number."});
    }
  }
  if (!errors.empty()) {
    throw Error(ErrorCode::invalid_argument, "Correct the fields listed under errors.", std::move(errors));
  }
  return parse_method(texts);
}

RegistrationRequest registration_wish(std::string_view text) {
  const Json json = object_in(text, "{\"fixed\": id, \"moving\": id}");
  RegistrationRequest wish;
  RegistrationOptions& options = wish.options;
  std::vector<FieldError> errors;
  const auto wrong = [&](std::string_view key, std::string detail) {
    errors.push_back({pointer_to(key), std::move(detail)});
  };
  const auto finite = [](const Json& j) { return j.is_number() && std::isfinite(j.get<double>()); };
  const auto count = [&](std::string_view key, const Json& value, std::uint32_t& to) {
    if (!value.is_number_unsigned() || value.get<std::uint64_t>() > 0xffffffffU)
      return wrong(key, "Give a whole number.");
    to = value.get<std::uint32_t>();
  };
  for (const auto& [key, value] : json.items()) {
    if (key == "fixed" || key == "moving") {
      if (value.is_string()) {
        (key == "fixed" ? wish.fixed : wish.moving) = value;
      } else {
        wrong(key, "Give the id of a stored model.");
      }
    } else if (key == "transform") {
      options.transform = value == "rigid"    ? TransformKind::rigid
                          : value == "affine" ? TransformKind::affine
                                              : TransformKind::similarity;
      if (value != "rigid" && value != "similarity" && value != "affine")
        wrong(key, "Give \"rigid\", \"similarity\" or \"affine\".");
    } else if (key == "method") {
      options.method = value == "matching" ? RegistrationMethod::matching : RegistrationMethod::global;
      if (value != "global" && value != "matching") wrong(key, "Give \"global\" or \"matching\".");
    } else if (key == "k") {
      count(key, value, options.k);
    } else if (key == "inits") {
      count(key, value, options.inits);
    } else if (key == "seed") {
      if (value.is_number_unsigned()) options.seed = value;
      if (!value.is_number_unsigned()) wrong(key, "Give a whole number, at least 0.");
    } else if (key == "refine") {
      if (value.is_boolean()) options.refine = value;
      if (!value.is_boolean()) wrong(key, "Give true or false.");
    } else if (key == "scale_bounds") {
      if (value.is_array() && value.size() == 2 && finite(value[0]) && finite(value[1])) {
        options.min_scale = value[0];
        options.max_scale = value[1];
      } else {
        wrong(key, "Give two positive numbers, the lower one first.");
      }
    } else if (key == "weights") {
      if (!value.is_object()) {
        wrong(key, "Give an object of numbers: position, size, shape, alone.");
        continue;
      }
      for (const auto& [name, weight] : value.items()) {
        double* const to = name == "position" ? &options.weights.position
                           : name == "size"   ? &options.weights.size
                           : name == "shape"  ? &options.weights.shape
                           : name == "alone"  ? &options.weights.alone
                                              : nullptr;
        if (to == nullptr || !finite(weight)) {
          errors.push_back(
              {"/weights" + pointer_to(name), "Known are position, size, shape and alone, each a number."});
        } else {
          *to = weight;
        }
      }
    } else {
      wrong(key,
            "There is no such field; known are fixed, moving, transform, method, k, inits, scale_bounds, weights, "
            "refine, seed.");
    }
  }
  for (const char* id : {"fixed", "moving"})
    if (!json.contains(id)) wrong(id, "Give the id of a stored model.");
  if (!errors.empty()) {
    throw Error(ErrorCode::invalid_argument, "Correct the fields listed under errors.", std::move(errors));
  }
  check_registration_options(options);
  return wish;
}

BeforeAfterRequest before_after_request(const Request& request) {
  std::vector<std::string_view> known;
  for (const std::string_view name : render_option_names())
    if (name != "layout" && name != "turntable") known.push_back(name);
  known.push_back("of");
  const Query query(request, known);
  BeforeAfterRequest wanted;
  wanted.few = query.choice("of", {"models", "spheres"}) == "spheres";
  OptionTexts given = request.query;
  std::erase_if(given, [](const auto& pair) { return pair.first == "of"; });
  wanted.options = parse_render_options(given);
  wanted.options.layout = Layout::overlaid;
  check_render_options(wanted.options);
  return wanted;
}

std::string query_of(const BeforeAfterRequest& request) {
  RenderOptions options = request.options;
  options.layout = Layout::beside;
  std::string query = query_of(RenderRequest{.options = options, .with = {}});
  if (request.few) query += query.empty() ? "?of=spheres" : "&of=spheres";
  return query;
}

AppliedRequest applied_wish(std::string_view text) {
  if (text.empty()) return {};
  const Json json = object_in(text, "{\"what\": \"volume\"}");
  for (const auto& [key, value] : json.items()) {
    if (key != "what")
      throw Error(ErrorCode::invalid_argument, "Correct the fields listed under errors.",
                  {{pointer_to(key), "There is no such field; known is what."}});
    if (value != "volume" && value != "model")
      throw Error(ErrorCode::invalid_argument, "Correct the fields listed under errors.",
                  {{"/what", "Give \"volume\" or \"model\"."}});
  }
  return {json.value("what", "volume") == "model" ? Applied::model : Applied::volume};
}

double acceptability(std::string_view accept, std::string_view type) {
  if (trimmed(accept).empty()) return 1;
  const std::string_view major = type.substr(0, type.find('/'));
  double quality = 0;
  int best = -1;
  split(accept, ',', [&](std::string_view range) {
    std::string_view media = range.substr(0, range.find(';'));
    const std::string wanted = lower(trimmed(media));
    const int specificity = wanted == type ? 2 : wanted == std::string(major) + "/*" ? 1 : wanted == "*/*" ? 0 : -1;
    if (specificity <= best) return;
    best = specificity;
    quality = 1;
    split(range.substr(media.size()), ';', [&](std::string_view parameter) {
      if (lower(parameter.substr(0, 2)) == "q=") quality = parse_number<double>(parameter.substr(2)).value_or(1);
    });
  });
  return std::clamp(quality, 0.0, 1.0);
}

std::size_t negotiate(std::string_view accept, std::span<const std::string_view> types) {
  std::size_t best = types.size();
  double quality = 0;
  for (std::size_t i = 0; i < types.size(); ++i) {
    if (const double q = acceptability(accept, types[i]); q > quality) best = i, quality = q;
  }
  if (best == types.size()) {
    std::string list;
    for (const std::string_view type : types) list += (list.empty() ? "" : ", ") + std::string(type);
    throw HttpError(406, "Ask for a media type that this resource has: " + list + ".");
  }
  return best;
}

std::string media_type(std::string_view content_type) {
  return lower(trimmed(content_type.substr(0, content_type.find(';'))));
}

bool is_json(const Request& request) {
  const std::string type = media_type(request.header("Content-Type"));
  return type.empty() || type == "application/json" || type.ends_with("+json") ||
         type == "application/x-www-form-urlencoded";
}

std::optional<std::chrono::seconds> preferred_wait(const Request& request) {
  std::optional<std::chrono::seconds> wait;
  for (const auto& [name, value] : request.headers) {
    if (lower(name) != "prefer") continue;
    split(value, ',', [&](std::string_view preference) {
      const std::string word = lower(preference.substr(0, preference.find(';')));
      // RFC 7240: the first of repeated preferences counts, malformed ones are ignored.
      if (wait) return;
      if (word == "respond-async") wait = std::chrono::seconds(0);
      if (!word.starts_with("wait=")) return;
      std::string_view number = trimmed(std::string_view(word).substr(5));
      if (number.size() > 1 && number.front() == '"' && number.back() == '"') {
        number = number.substr(1, number.size() - 2);
      }
      const auto seconds = parse_number<std::int64_t>(number);
      if (seconds && ranges::wait_s.holds(*seconds)) wait = std::chrono::seconds(*seconds);
    });
  }
  return wait;
}

namespace {

// One range of a set; of no length when it lies outside, nothing when it is malformed.
std::optional<ByteRange> one_range(std::string_view range, std::uint64_t bytes) {
  const std::size_t dash = range.find('-');
  if (dash == std::string_view::npos) return std::nullopt;
  const std::string_view from = range.substr(0, dash), to = range.substr(dash + 1);
  const auto first = parse_number<std::uint64_t>(from), last = parse_number<std::uint64_t>(to);
  if ((!from.empty() && !first) || (!to.empty() && !last) || (!first && !last)) return std::nullopt;
  if (first && last && *last < *first) return std::nullopt;
  const std::uint64_t begin = first ? *first : bytes - std::min(bytes, *last);
  const std::uint64_t end = first && last && *last < bytes ? *last + 1 : bytes;
  return ByteRange{begin, begin < end ? end - begin : 0};
}

}  // namespace

std::vector<ByteRange> byte_ranges(std::string_view header, std::uint64_t bytes) {
  if (!header.starts_with("bytes=")) return {};
  std::vector<ByteRange> ranges;
  std::size_t asked = 0;
  std::uint64_t together = 0;
  bool good = true;
  split(header.substr(6), ',', [&](std::string_view text) {
    if (text.empty() || ++asked > kMostRanges) good = good && text.empty();  // elements of lists may be empty
    if (text.empty() || !good) return;
    const auto range = one_range(text, bytes);
    good = range.has_value();
    if (!good || range->length == 0) return;
    ranges.push_back(*range);
    together += range->length;
  });
  // Who asks for more than there is gets what there is.
  if (!good || asked == 0 || (ranges.size() > 1 && together > bytes)) return {};
  if (ranges.empty()) {
    throw HttpError(416, "Ask for a range within the content's " + std::to_string(bytes) + " bytes.",
                    {{"Content-Range", "bytes */" + std::to_string(bytes)}});
  }
  return ranges;
}

bool matches_etag(std::string_view if_none_match, std::string_view etag) {
  bool found = trimmed(if_none_match) == "*";
  split(if_none_match, ',', [&](std::string_view tag) {
    if (tag.starts_with("W/")) tag.remove_prefix(2);
    found = found || tag == etag;
  });
  return found;
}

}  // namespace spherule::api
