// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/e2e/client.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <httplib.h>

#include <cmath>
#include <cstring>

#include "tests/contract/contract.h"

namespace spherule::test {

namespace {

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

}  // namespace

std::string Answer::header(const std::string& name) const {
  const auto found = headers.find(lower(name));
  return found == headers.end() ? "" : found->second;
}

Answer Client::ask(const std::string& method, const std::string& target, const Ask& ask) const {
  httplib::Client http("127.0.0.1", port_);
  http.set_read_timeout(static_cast<time_t>(ask.timeout_s));
  http.set_decompress(false);
  httplib::Request request;
  request.method = method;
  request.path = target;
  request.body = ask.body;
  for (const auto& [name, value] : ask.headers) request.set_header(name, value);
  const std::string type = ask.type.empty() && ask.body.starts_with("{") ? "application/json" : ask.type;
  if (!type.empty()) request.set_header("Content-Type", type);
  const httplib::Result result = http.send(request);
  Answer answer;
  if (!result) return answer;
  answer.status = result->status;
  answer.body = result->body;
  for (const auto& [name, value] : result->headers) answer.headers.emplace(lower(name), value);
  const std::string pattern = template_of(target);
  const bool readable = answer.header("Content-Encoding").empty();
  if (!pattern.empty() && answer.status != 405 && method != "OPTIONS" && readable) {
    for (const std::string& wrong : violations(method, target.substr(0, target.find('?')), answer.status,
                                               answer.header("Content-Type"), answer.body)) {
      ADD_FAILURE() << wrong << "\n" << answer.body.substr(0, 2000);
    }
  }
  if (answer.status >= 400) {
    EXPECT_EQ(answer.header("Content-Type"), "application/problem+json") << method << " " << target;
  }
  EXPECT_FALSE(answer.header("X-Request-Id").empty()) << method << " " << target;
  return answer;
}

std::string Client::upload(const std::string& query, const std::string& bytes) const {
  const Answer answer = post("/v1/volumes" + query, {.body = bytes, .type = "application/octet-stream"});
  EXPECT_TRUE(answer.status == 200 || answer.status == 201) << answer.status << answer.body;
  return answer.json().value("id", "");
}

Json Client::model(const Json& wish) const {
  const Answer answer =
      post("/v1/models", {.headers = {{"Prefer", "wait=60"}}, .body = wish.dump(), .type = "application/json"});
  EXPECT_TRUE(answer.status == 200 || answer.status == 201) << answer.status << answer.body;
  return answer.json();
}

std::string Client::raw(const std::string& bytes, int patience_s) const {
  const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port_));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const timeval patience{.tv_sec = patience_s, .tv_usec = 0};
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  std::string answer;
  if (::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) {
    for (std::size_t at = 0; at < bytes.size();) {
      const ssize_t n = ::send(fd, bytes.data() + at, bytes.size() - at, MSG_NOSIGNAL);
      if (n <= 0) break;
      at += static_cast<std::size_t>(n);
    }
    const timeval silence{.tv_sec = 1, .tv_usec = 0};
    std::array<char, 4096> piece{};
    for (ssize_t n; (n = ::recv(fd, piece.data(), piece.size(), 0)) > 0;) {
      answer.append(piece.data(), static_cast<std::size_t>(n));
      ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &silence, sizeof silence);
    }
  }
  ::close(fd);
  return answer;
}

std::string ball(int n, double radius) {
  std::string bytes;
  const double middle = 0.5 * (n - 1);
  for (int k = 0; k < n; ++k) {
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) {
        const double d = std::hypot(i - middle, j - middle, k - middle);
        bytes +=
            static_cast<char>(static_cast<unsigned char>(std::lround(std::clamp(255 * (1 - d / radius), 0., 255.))));
      }
    }
  }
  return bytes;
}

std::string ball_nifti(int n, double radius, float spacing) {
  std::string header(352, '\0');
  const auto put = [&](std::size_t at, auto value) { std::memcpy(header.data() + at, &value, sizeof value); };
  put(0, std::int32_t{348});
  const auto size = static_cast<std::int16_t>(n);
  const std::array<std::int16_t, 8> dim = {3, size, size, size, 1, 1, 1, 1};
  put(40, dim);
  put(70, std::int16_t{2});  // uint8
  put(72, std::int16_t{8});
  const std::array<float, 8> pixdim = {1, spacing, spacing, spacing, 0, 0, 0, 0};
  put(76, pixdim);
  put(108, 352.0F);
  put(112, 1.0F);             // slope
  put(123, char{2});          // mm
  put(254, std::int16_t{1});  // sform
  put(280, std::array<float, 4>{spacing, 0, 0, 0});
  put(296, std::array<float, 4>{0, spacing, 0, 0});
  put(312, std::array<float, 4>{0, 0, spacing, 0});
  std::memcpy(header.data() + 344, "n+1", 4);
  return header + ball(n, radius);
}

}  // namespace spherule::test
