// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/http/idempotency.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "api/http/negotiation.h"
#include "api/http/problem.h"

namespace spherule::api {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kLongestKey = 255;

// FNV-1a, 64 bits. It guards against mistakes, not against enemies: a key is its client's own.
class Fingerprint {
 public:
  void add(std::string_view bytes) {
    for (const char c : bytes) hash_ = (hash_ ^ static_cast<unsigned char>(c)) * 0x100000001b3U;
    length_ += bytes.size();
  }
  std::string text() const { return std::to_string(hash_) + "/" + std::to_string(length_); }

 private:
  std::uint64_t hash_ = 0xcbf29ce484222325U, length_ = 0;
};

// A body that is fingerprinted as it is read.
class WatchedBody final : public Body {
 public:
  WatchedBody(Body& body, Fingerprint& fingerprint) : body_(body), fingerprint_(fingerprint) {}
  bool present() const override { return body_.present(); }
  std::uint64_t announced() const override { return body_.announced(); }
  void read(std::uint64_t limit, const Take& take) override {
    read_ = true;
    body_.read(limit, [&](std::string_view piece) {
      fingerprint_.add(piece);
      take(piece);
    });
  }
  void read_parts(std::uint64_t limit, const BeginPart& begin, const Take& take) override {
    read_ = true;
    body_.read_parts(
        limit,
        [&](std::string_view name, std::string_view filename) {
          fingerprint_.add(std::string(name) + "\n" + std::string(filename) + "\n");
          begin(name, filename);
        },
        [&](std::string_view piece) {
          fingerprint_.add(piece);
          take(piece);
        });
  }
  // For nothing but the fingerprint.
  void read_through(std::uint64_t limit, std::string_view content_type) {
    if (read_ || !present()) return;
    if (media_type(content_type) == "multipart/form-data") {
      read_parts(
          limit, [](std::string_view, std::string_view) {}, [](std::string_view) {});
    } else {
      read(limit, [](std::string_view) {});
    }
  }

 private:
  Body& body_;
  Fingerprint& fingerprint_;
  bool read_ = false;
};

Json document(const Response& response, const std::string& fingerprint) {
  Json headers = Json::array();
  for (const auto& [name, value] : response.headers) headers.push_back({name, value});
  return {{"fingerprint", fingerprint},
          {"status", response.status},
          {"headers", std::move(headers)},
          {"body", std::get<std::string>(response.body)}};
}

Response replay(const Json& kept) {
  Response response{.status = kept.at("status"), .body = kept.at("body").get<std::string>()};
  for (const Json& header : kept.at("headers")) response.set(header.at(0), header.at(1));
  response.set("Idempotency-Replayed", "true");
  return response;
}

}  // namespace

Response answer_once(Service& service, const Request& request, const std::function<Response(const Request&)>& answer) {
  const std::string_view given = request.header("Idempotency-Key");
  if (given.empty() || request.method != "POST") return answer(request);
  if (given.size() > kLongestKey || !std::ranges::all_of(given, [](char c) { return c > ' ' && c < 0x7f; })) {
    throw Error(ErrorCode::invalid_argument,
                "Send an Idempotency-Key of at most 255 visible ASCII characters, such as a UUID.");
  }
  const std::string key = request.client + "\n" + std::string(given);
  const std::uint64_t limit = service.limits().upload_bytes;
  Fingerprint fingerprint;
  fingerprint.add(request.path);
  for (const auto& [name, value] : request.query) fingerprint.add("\n" + name + "=" + value);
  fingerprint.add("\n\n");
  struct NoBody final : Body {
    bool present() const override { return false; }
    std::uint64_t announced() const override { return 0; }
    void read(std::uint64_t, const Take&) override {}
    void read_parts(std::uint64_t, const BeginPart&, const Take&) override {}
  } none;
  WatchedBody body(request.body != nullptr ? *request.body : none, fingerprint);

  if (const std::optional<std::string> kept = service.replies().recall(key)) {
    const Json reply = Json::parse(*kept);
    body.read_through(limit, request.header("Content-Type"));
    if (reply.at("fingerprint") != fingerprint.text()) {
      throw HttpError(422, "This Idempotency-Key came with another request before; use a new one.");
    }
    return replay(reply);
  }
  // The key is ours until the reply is kept or given up.
  struct Reservation {
    Service& service;
    const std::string& key;
    bool kept = false;
    ~Reservation() {
      if (!kept) service.replies().release(key);
    }
  } reservation{service, key};
  Request watched = request;
  watched.body = &body;
  Response response = answer(watched);
  if (response.status < 300 && std::holds_alternative<std::string>(response.body)) {
    body.read_through(limit, request.header("Content-Type"));
    service.replies().keep(key, document(response, fingerprint.text()).dump());
    reservation.kept = true;
  }
  return response;
}

}  // namespace spherule::api
