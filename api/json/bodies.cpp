// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/json/bodies.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "api/json/label_json.h"
#include "core/base/error.h"
#include "core/base/ranges.h"
#include "core/base/text.h"

namespace spherule::api {

namespace {

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

// What is wrong with a value, told of it; nothing when it was taken.
using Wrong = std::optional<std::string>;

// One field of a body: how its value is taken.
template <typename T>
struct Field {
  std::string_view name;
  Wrong (*take)(const Json& value, T& to);
};

template <typename T, std::size_t n>
void take_fields(const Json& object, const std::string& at, const std::array<Field<T>, n>& fields, T& to,
                 std::vector<FieldError>& errors) {
  std::array<std::string_view, n> names;
  std::ranges::transform(fields, names.begin(), &Field<T>::name);
  for (const auto& [key, value] : object.items()) {
    const auto field = std::ranges::find(fields, key, &Field<T>::name);
    const Wrong wrong =
        field == fields.end() ? "There is no such field; known are " + listed(names) + "." : field->take(value, to);
    if (wrong) errors.push_back({at + pointer_to(key), *wrong});
  }
}

void throw_if_any(std::vector<FieldError> errors) {
  if (!errors.empty())
    throw Error(ErrorCode::invalid_argument, "Correct the fields listed under errors.", std::move(errors));
}

Wrong take_text(const Json& value, std::string& to, const char* sentence) {
  if (!value.is_string()) return sentence;
  to = value;
  return {};
}

Wrong take_count(const Json& value, std::uint32_t& to) {
  if (!value.is_number_unsigned() || value.get<std::uint64_t>() > 0xffffffffU) return "Give a whole number.";
  to = value;
  return {};
}

bool is_finite(const Json& value) { return value.is_number() && std::isfinite(value.get<double>()); }

// One of the words, which are enumerators' names.
template <typename E>
Wrong take_word(const Json& value, E& to, std::initializer_list<std::pair<const char*, E>> words) {
  std::string known;
  for (const auto& [word, enumerator] : words) {
    if (value == word) {
      to = enumerator;
      return {};
    }
    const bool last = word == std::prev(words.end())->first;
    known += (known.empty() ? "\"" : last ? " or \"" : ", \"") + std::string(word) + "\"";
  }
  return "Give " + known + ".";
}

bool is_sample(const Json& j) { return j.is_number() && ranges::value.holds(j.get<double>()); }

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

constexpr const char* kNameAVolume = "Give the id of a stored volume.";
constexpr auto kModelFields = std::to_array<Field<ModelBody>>({
    {"volume", [](const Json& value, ModelBody& to) { return take_text(value, to.volume, kNameAVolume); }},
    {"threshold",
     [](const Json& value, ModelBody& to) -> Wrong {
       if (!is_sample(value)) return "Give a number " + ranges::value.words() + ".";
       to.rule.lo = value;
       return {};
     }},
    {"range",
     [](const Json& value, ModelBody& to) -> Wrong {
       if (!value.is_array() || value.size() != 2 || !is_sample(value[0]) || !is_sample(value[1]) ||
           value[0] > value[1])
         return "Give two numbers [lo, hi] " + ranges::value.words() + ", with lo no greater than hi.";
       to.rule.kind = ObjectRule::Kind::range;
       to.rule.lo = value[0];
       to.rule.hi = value[1];
       return {};
     }},
    {"labels",
     [](const Json& value, ModelBody& to) -> Wrong {
       to.rule.kind = ObjectRule::Kind::labels;
       to.rule.labels = labels_in(value);
       if (!to.rule.labels.empty()) return {};
       return "Give an array of whole numbers from -2^63 to 2^64 - 1, large ones as strings.";
     }},
    {"inside",
     [](const Json& value, ModelBody& to) {
       to.side_given = true;
       return take_word(value, to.rule.side, {{"above", Side::above}, {"below", Side::below}});
     }},
    {"border",
     [](const Json& value, ModelBody& to) {
       return take_word(value, to.rule.border, {{"closed", Border::closed}, {"open", Border::open}});
     }},
});

constexpr const char* kNameAModel = "Give the id of a stored model.";
template <double MatchingWeights::*member>
Wrong take_weight(const Json& value, MatchingWeights& to) {
  if (!is_finite(value)) return "Known are position, size, shape and alone, each a number.";
  to.*member = value;
  return {};
}
constexpr auto kWeightFields = std::to_array<Field<MatchingWeights>>({
    {"position", take_weight<&MatchingWeights::position>},
    {"size", take_weight<&MatchingWeights::size>},
    {"shape", take_weight<&MatchingWeights::shape>},
    {"alone", take_weight<&MatchingWeights::alone>},
});

constexpr auto kRegistrationFields = std::to_array<Field<RegistrationRequest>>({
    {"fixed", [](const Json& value, RegistrationRequest& to) { return take_text(value, to.fixed, kNameAModel); }},
    {"moving", [](const Json& value, RegistrationRequest& to) { return take_text(value, to.moving, kNameAModel); }},
    {"transform",
     [](const Json& value, RegistrationRequest& to) {
       return take_word(value, to.options.transform,
                        {{"rigid", TransformKind::rigid},
                                   {"similarity", TransformKind::similarity},
                                   {"affine", TransformKind::affine}});
     }},
    {"method",
     [](const Json& value, RegistrationRequest& to) {
       return take_word(
           value, to.options.method,
           {{"global", RegistrationMethod::global}, {"matching", RegistrationMethod::matching}});
     }},
    {"k", [](const Json& value, RegistrationRequest& to) { return take_count(value, to.options.k); }},
    {"inits", [](const Json& value, RegistrationRequest& to) { return take_count(value, to.options.inits); }},
    {"scale_bounds",
     [](const Json& value, RegistrationRequest& to) -> Wrong {
       if (!value.is_array() || value.size() != 2 || !is_finite(value[0]) || !is_finite(value[1]))
         return "Give two positive numbers, the lower one first.";
       to.options.min_scale = value[0];
       to.options.max_scale = value[1];
       return {};
     }},
    // Its own fields are taken after it.
    {"weights",
     [](const Json& value, RegistrationRequest&) -> Wrong {
       if (!value.is_object()) return "Give an object of numbers: position, size, shape, alone.";
       return {};
     }},
    {"refine",
     [](const Json& value, RegistrationRequest& to) -> Wrong {
       if (!value.is_boolean()) return "Give true or false.";
       to.options.refine = value;
       return {};
     }},
    {"seed",
     [](const Json& value, RegistrationRequest& to) -> Wrong {
       if (!value.is_number_unsigned()) return "Give a whole number, at least 0.";
       to.options.seed = value;
       return {};
     }},
});

}  // namespace

ModelBody model_body(std::string_view text) {
  const Json json = object_in(text, "{\"volume\": id, \"threshold\": 60.5}");
  ModelBody body;
  std::vector<FieldError> errors;
  take_fields(json, {}, kModelFields, body, errors);
  if (!json.contains("volume")) errors.push_back({"/volume", kNameAVolume});
  const auto objects = json.count("threshold") + json.count("range") + json.count("labels");
  if (objects != 1) errors.push_back({"", "Give exactly one of threshold, range and labels."});
  throw_if_any(std::move(errors));
  return body;
}

SimplifyMethod simplification_body(std::string_view text) {
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
  throw_if_any(std::move(errors));
  return parse_method(texts);
}

RegistrationRequest registration_body(std::string_view text) {
  const Json json = object_in(text, "{\"fixed\": id, \"moving\": id}");
  RegistrationRequest body;
  std::vector<FieldError> errors;
  take_fields(json, {}, kRegistrationFields, body, errors);
  if (json.contains("weights") && json["weights"].is_object())
    take_fields(json["weights"], "/weights", kWeightFields, body.options.weights, errors);
  for (const char* id : {"fixed", "moving"})
    if (!json.contains(id)) errors.push_back({pointer_to(id), kNameAModel});
  throw_if_any(std::move(errors));
  check_registration_options(body.options);
  return body;
}

AppliedRequest apply_body(std::string_view text) {
  if (text.empty()) return {};
  constexpr auto fields = std::to_array<Field<AppliedRequest>>({
      {"what",
       [](const Json& value, AppliedRequest& to) {
         return take_word(value, to.what, {{"volume", Applied::volume}, {"model", Applied::model}});
       }},
  });
  AppliedRequest body;
  std::vector<FieldError> errors;
  take_fields(object_in(text, "{\"what\": \"volume\"}"), {}, fields, body, errors);
  throw_if_any(std::move(errors));
  return body;
}

}  // namespace spherule::api
