// SPDX-License-Identifier: GPL-3.0-or-later
//
// The head of a request: its request line and its fields, read strictly by RFC 9112 and RFC 9110. Two readers of the
// same bytes must never see two different requests, so what a lenient reader would mend is refused here: a line that
// ends otherwise than in CR LF, white space before a colon, folded lines, control characters, and a length that is not
// said exactly once. Values are handed on as they came; nothing is decoded.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace spherule::server {

using Fields = std::vector<std::pair<std::string, std::string>>;

struct HeadLimits {
  std::size_t bytes = 1 << 15;   ///< of a whole head; more are refused with 431
  std::size_t fields = 100;      ///< likewise
  std::size_t target = 1 << 13;  ///< bytes of the request target; more are refused with 414
};

struct Head {
  std::string method;  ///< a token; not necessarily a method of ours
  std::string target;  ///< as sent, from the path on ("/v1/models?limit=2"), or "*"
  Fields fields;       ///< in their order; white space around values is left out
  bool version_1_0 = false;
  bool persistent = true;  ///< the client would send another request on this connection
  bool expects_continue = false;
  bool chunked = false;
  std::uint64_t length = 0;  ///< of the body; 0 for none and for a chunked one

  bool has_body() const { return chunked || length > 0; }
  /// The first field of this name (in any case), or an empty text.
  std::string_view field(std::string_view name) const;
};

/// Why bytes are no head: the status to answer with, and a sentence for the client. The connection is good for nothing
/// else then.
struct HeadRefusal {
  int status = 400;
  const char* sentence = "";
};

/// Reads heads from bytes as they arrive, in pieces of any size: the result does not depend on the cuts. Keeps at most
/// HeadLimits::bytes, and looks at every byte a fixed number of times.
class HeadReader {
 public:
  explicit HeadReader(const HeadLimits& limits) : limits_(limits) {}

  /// Takes bytes up to the end of the head, or all; returns how many. Takes none once complete() or refusal().
  std::size_t feed(std::string_view bytes);
  bool complete() const { return complete_; }
  const std::optional<HeadRefusal>& refusal() const { return refusal_; }
  /// Whether a head has begun and is neither complete nor refused.
  bool begun() const { return !complete_ && !refusal_ && (!line_.empty() || !head_.method.empty()); }

  /// The head, once complete; the reader is ready for the next one then.
  Head take();

 private:
  void take_line(std::string_view line);

  HeadLimits limits_;
  std::string line_;       // so far, with its end
  std::string authority_;  // that the target names
  std::size_t read_ = 0;
  bool complete_ = false;
  std::optional<HeadRefusal> refusal_;
  Head head_;
};

/// "name: value" as a field; nothing when it is none.
std::optional<std::pair<std::string, std::string>> parse_field(std::string_view line);

/// The name in a Host field or an origin's authority, without the port, in lower case, an IPv6 address in its brackets;
/// nothing when the text is none.
std::optional<std::string> host_name(std::string_view authority);

struct Target {
  std::string path;  ///< percent-decoded
  Fields query;      ///< decoded, "+" as a space
};
/// Percent signs without two hex digits stand for themselves.
Target parse_target(std::string_view target);

}  // namespace spherule::server
