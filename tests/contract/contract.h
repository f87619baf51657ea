// SPDX-License-Identifier: GPL-3.0-or-later
//
// openapi.yaml as a judge of answers: what it lists, and whether an answer keeps to it.
#pragma once

#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace spherule::test {

/// Every (method, path template), in the file's order; methods in capitals.
std::vector<std::pair<std::string, std::string>> contract_operations();

/// The statuses that the contract lists for an operation; `default` is one.
std::set<std::string> listed_statuses(const std::string& method, const std::string& path);

/// What is wrong with an answer to `method path`, by the contract: a status that is not listed for the operation, a
/// media type that is not listed for the status, a JSON body that does not fit its schema. Empty: nothing. HEAD counts
/// as GET, and its body is not looked at.
std::vector<std::string> violations(std::string_view method, std::string_view path, int status,
                                    std::string_view content_type, std::string_view body);

/// What is wrong with the contract's own examples, by its schemas.
std::vector<std::string> example_violations();

/// A number that a request may hold.
struct RequestNumber {
  std::string method, path;
  std::string in;       ///< query, path, header or body
  std::string name;     ///< of the parameter, or the pointer to it in the body
  std::string variant;  ///< where a body has alternatives: the `method` of this one
  bool whole = false;
  std::string least, most;  ///< as they are written in JSON; empty where the contract has none
  bool above = false;       ///< `least` itself is not allowed
  std::size_t items = 0;    ///< of a list: how many there are at least; 0: one number
};
/// All of them, in the contract's order.
std::vector<RequestNumber> request_numbers();

/// The template of a path, or an empty string.
std::string template_of(std::string_view path);

}  // namespace spherule::test
