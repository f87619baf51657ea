// SPDX-License-Identifier: GPL-3.0-or-later
//
// Talks to a server and holds every answer against the contract.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

namespace spherule::test {

using Json = nlohmann::json;

struct Answer {
  int status = 0;                              ///< 0: no answer came
  std::map<std::string, std::string> headers;  ///< names in lower case
  std::string body;

  std::string header(const std::string& name) const;
  Json json() const { return Json::parse(body, nullptr, false); }
};

struct Ask {
  std::map<std::string, std::string> headers{};
  std::string body{};
  std::string type{};  ///< empty: JSON for a body that starts like it
  double timeout_s = 120;
};

class Client {
 public:
  explicit Client(int port) : port_(port) {}

  /// One exchange on a connection of its own. Everything that breaks the contract fails the running test.
  Answer ask(const std::string& method, const std::string& target, const Ask& ask = {}) const;
  Answer get(const std::string& target, const Ask& extra = {}) const { return ask("GET", target, extra); }
  Answer post(const std::string& target, const Ask& extra = {}) const { return ask("POST", target, extra); }

  /// Uploads and gives the volume's id; fails the test unless it is stored.
  std::string upload(const std::string& query, const std::string& bytes) const;
  /// Makes a model, waiting for it, and gives its document.
  Json model(const Json& wish) const;

  /// Sends `bytes` as they are, and gives all that comes back until the server closes or has been silent for a
  /// second; at most `patience_s` for the first byte.
  std::string raw(const std::string& bytes, int patience_s = 30) const;

 private:
  int port_;
};

/// A ball of this radius about the middle of an n³ grid of bytes: 255 at the centre, falling linearly.
std::string ball(int n, double radius);
/// The same as a NIfTI-1 file with this spacing.
std::string ball_nifti(int n, double radius, float spacing);

}  // namespace spherule::test
