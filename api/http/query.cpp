// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/http/query.h"

namespace spherule::api {

void refuse_parameter(std::string_view name, const std::string& detail) {
  throw Error(ErrorCode::invalid_argument, "Correct the parameters listed under errors.",
              {{std::string(name), detail}});
}

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
                                              : "There is no such parameter here; known are " + listed(known) + "."});
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
  const auto value = number_in<std::int64_t>(*given);
  if (!value || !range.holds(*value)) refuse_parameter(name, "Give a whole number " + range.words() + ".");
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
    const auto value = number_in<double>(unspaced(rest.substr(0, end)));
    good = value && range.holds(*value) && values.size() < count;
    if (good) values.push_back(*value);
    rest.remove_prefix(std::min(end + 1, rest.size()));
  }
  if (!good || values.size() != count) {
    refuse_parameter(name, count == 1 ? "Give a number " + range.words() + "."
                                      : "Give " + std::to_string(count) + " numbers with commas between, each " +
                                            range.words() + ".");
  }
  return values;
}

std::optional<std::string> Query::choice(std::string_view name, std::initializer_list<std::string_view> choices) const {
  const auto given = text(name);
  if (given && std::ranges::find(choices, *given) == choices.end())
    refuse_parameter(name, "Give one of " + listed({choices.begin(), choices.size()}) + ".");
  return given;
}

}  // namespace spherule::api
