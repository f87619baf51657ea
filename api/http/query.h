// SPDX-License-Identifier: GPL-3.0-or-later
//
// Query parameters, checked. Whatever is unknown is refused by name.
#pragma once

#include <algorithm>
#include <cstdint>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "api/http/http.h"
#include "core/base/ranges.h"
#include "core/base/text.h"

namespace spherule::api {

/// Whether text is well-formed UTF-8 (RFC 3629).
bool is_utf8(std::string_view text);

/// The query parameters of a request, of which only `known` may occur, each once and in UTF-8. The functions throw
/// invalid_argument with the parameter's name as pointer.
class Query {
 public:
  Query(const Request& request, std::initializer_list<std::string_view> known)
      : Query(request, std::span(known.begin(), known.size())) {}
  Query(const Request& request, std::span<const std::string_view> known);

  std::optional<std::string> text(std::string_view name) const;
  /// A whole number of the range.
  std::optional<std::int64_t> integer(std::string_view name, const ranges::Whole& range) const;
  /// Exactly `count` numbers of the range, with commas between.
  std::optional<std::vector<double>> numbers(std::string_view name, std::size_t count, const ranges::Real& range) const;
  /// One of `choices`.
  std::optional<std::string> choice(std::string_view name, std::initializer_list<std::string_view> choices) const;

 private:
  const Request& request_;
};

/// Throws invalid_argument that says of a parameter what to do.
[[noreturn]] void refuse_parameter(std::string_view name, const std::string& detail);

/// Without the blanks that HTTP allows around a word.
inline std::string_view unspaced(std::string_view text) { return trimmed(text, " \t"); }

/// Calls f with each piece between separators that is not empty once it is unspaced.
template <typename F>
void each_word(std::string_view text, char separator, F&& f) {
  while (!text.empty()) {
    const std::size_t end = std::min(text.find(separator), text.size());
    if (const std::string_view word = unspaced(text.substr(0, end)); !word.empty()) f(word);
    text.remove_prefix(std::min(end + 1, text.size()));
  }
}

}  // namespace spherule::api
