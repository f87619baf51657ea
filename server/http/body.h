// SPDX-License-Identifier: GPL-3.0-or-later
//
// The body of a request on the network. What is done here and why (cpp-httplib 0.11.4):
// - Bodies are always taken through its ContentReader, counted and unpacked here: elsewhere it buffers them whole,
//   ignores its own limit for chunked ones, and takes a cut gzip stream for a complete one.
// - A request without Content-Length and chunking has no body; the library would wait for one.
#pragma once

#include <httplib.h>

#include <atomic>
#include <cstdint>
#include <exception>
#include <string>

#include "api/http.h"

namespace spherule::server {

/// The body's length by its headers.
struct Framing {
  bool present = false;
  std::uint64_t announced = 0;  ///< 0: chunked
};
/// Throws malformed where two readers could see two different bodies.
Framing framing(const httplib::Request& request);

class HttpBody final : public api::Body {
 public:
  /// `reader` is null for methods whose bodies the library does not read. All outlive the body; `stopping` ends reads
  /// that are under way. Throws what framing() throws.
  HttpBody(httplib::Request& request, const httplib::ContentReader* reader, const std::atomic<bool>& stopping);

  bool present() const override { return framing_.present; }
  std::uint64_t announced() const override { return framing_.announced; }
  void read(std::uint64_t limit, const Take& take) override;
  void read_parts(std::uint64_t limit, const BeginPart& begin_part, const Take& take) override;

  /// Whether the connection stands at the start of the next request.
  bool finished() const { return !framing_.present || finished_; }
  /// Reads on, for nothing, unless that is much.
  void drain();

 private:
  void begin(std::uint64_t limit);
  void receive(const Take& take);
  template <typename F>
  bool guarded(F&& f);
  void conclude(const char* cut);

  httplib::Request& request_;
  const httplib::ContentReader* reader_;
  const std::atomic<bool>& stopping_;
  Framing framing_;
  std::string encoding_, type_;
  bool begun_ = false, finished_ = false;
  std::exception_ptr error_;
};

}  // namespace spherule::server
