// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every number that a request may hold has a range in the contract, and that range is the one that is kept: its ends
// are taken, what lies just beyond them is refused by name.
#include <gtest/gtest.h>

#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>

#include "api/routes.h"
#include "core/base/ranges.h"
#include "tests/api/stub.h"
#include "tests/contract/contract.h"

namespace spherule::test {
namespace {

using Json = nlohmann::json;

std::string text_of(double value) {
  std::array<char, 32> text;
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), value).ptr};
}

// The decimal of `whole` and one more or less.
std::string next(const std::string& whole, int by) {
  __extension__ __int128 value = 0;
  for (const char c : whole)
    if (c != '-') value = 10 * value + (c - '0');
  if (whole[0] == '-') value = -value;
  value += by;
  std::string digits;
  const bool negative = value < 0;
  if (negative) value = -value;
  do digits.insert(digits.begin(), static_cast<char>('0' + static_cast<int>(value % 10)));
  while ((value /= 10) > 0);
  return negative ? "-" + digits : digits;
}

// The neighbours of a range's end, outwards and inwards.
std::string beyond(const RequestNumber& number, bool low) {
  const std::string& end = low ? number.least : number.most;
  if (low && number.above) return end;
  if (number.whole) return next(end, low ? -1 : 1);
  return text_of(std::nextafter(std::stod(end), low ? -INFINITY : INFINITY));
}
std::string within(const RequestNumber& number, bool low) {
  const std::string& end = low ? number.least : number.most;
  return low && number.above ? text_of(std::nextafter(std::stod(end), INFINITY)) : end;
}

// A request in which one number is `value`, and all else is as it has to be for that.
struct Asked {
  std::string target;
  std::vector<std::pair<std::string, std::string>> headers{};
  std::string body{};
};

// Of a list: the first for the low end, the last for the high one, and what fits beside them.
std::vector<std::string> list(const RequestNumber& number, bool low, const std::string& value) {
  std::vector<std::string> items;
  for (std::size_t i = 0; i < number.items; ++i) items.push_back(std::to_string(i + 1));
  if (number.name == "region") items = {"0", "0", "5", "5"};
  if (number.items == 1) return {value};
  (low ? items.front() : items.back()) = value;
  return items;
}
std::string joined(const std::vector<std::string>& items) {
  std::string text;
  for (const std::string& item : items) text += (text.empty() ? "" : ",") + item;
  return text;
}

std::string filled(std::string path, const std::string& name) {
  const auto fill = [&](const std::string& hole, const std::string& value) {
    if (const std::size_t at = path.find(hole); at != std::string::npos) path.replace(at, hole.size(), value);
  };
  fill("{volume}", kVolume), fill("{model}", kModel), fill("{job}", kJob), fill("{upload}", kUpload);
  fill("{registration}", kRegistration), fill("{axis}", "k");
  if (name != "index") fill("{index}", "5");
  fill("{format}", name == "detail" ? "glb" : name == "voxel_mm" ? "nifti" : "urdf");
  return path;
}

// What else a parameter needs to mean something.
std::string beside(const RequestNumber& number) {
  static const std::map<std::string, std::string> needed = {{"smoothness", "style=blobs"},
                                                            {"point_radius", "style=points"},
                                                            {"bucket_count", "buckets=0"},
                                                            {"look_at", "position=0,-9,0"},
                                                            {"up", "position=0,-9,0"},
                                                            {"field_of_view", "projection=perspective"},
                                                            {"colour_range", "colour_by=radius"},
                                                            {"window", "level=5"},
                                                            {"mark", "format=png"},
                                                            {"dims", "format=raw&dtype=uint8"},
                                                            {"spacing", "format=raw&dtype=uint8&dims=9,9,9"},
                                                            {"origin", "format=raw&dtype=uint8&dims=9,9,9"}};
  if (number.name == "level" && !number.whole) return "window=5";
  if (number.path.ends_with("/histogram") && (number.name == "width" || number.name == "height")) return "format=png";
  const auto found = needed.find(number.name);
  return found == needed.end() ? "" : found->second;
}

Asked asking(const RequestNumber& number, bool low, const std::string& value) {
  Asked asked{filled(number.path, number.name)};
  if (number.in == "path") {
    asked.target.replace(asked.target.find("{index}"), 7, value);
  } else if (number.in == "header") {
    asked.headers.emplace_back(number.name, value);
    if (number.name == "Upload-Offset") asked.headers.emplace_back("Content-Type", "application/offset+octet-stream");
  } else if (number.in == "query") {
    const std::string more = beside(number);
    asked.target += "?" + number.name + "=" + (number.items > 0 ? joined(list(number, low, value)) : value) +
                    (more.empty() ? "" : "&" + more);
    if (number.path == "/v1/volumes") asked.body = "samples";
  } else {
    std::string json = number.items > 0 ? "[" + joined(list(number, low, value)) + "]" : value;
    std::string key = number.name.substr(1);
    if (const auto slash = key.find('/'); slash != std::string::npos) {
      json = "{\"" + key.substr(slash + 1) + "\":" + json + "}";
      key = key.substr(0, slash);
    }
    asked.body = "\"" + key + "\":" + json + "}";
    if (key == "bucket_count") asked.body = "\"buckets\":[0]," + asked.body;
    if (key == "buckets") asked.body = "\"bucket_count\":65536," + asked.body;
    if (!number.variant.empty()) asked.body = "\"method\":\"" + number.variant + "\"," + asked.body;
    if (number.path == "/v1/models") asked.body = "\"volume\":\"" + kVolume + "\"," + asked.body;
    if (number.path == "/v1/registrations")
      asked.body = "\"fixed\":\"" + kModel + "\",\"moving\":\"" + kImported + "\"," + asked.body;
    asked.body = "{" + asked.body;
    asked.headers.emplace_back("Content-Type", "application/json");
  }
  return asked;
}

api::Response answer(const std::string& method, const Asked& asked) {
  StubService service;
  StubBody body(asked.body);
  api::Request request{
      .method = method, .path = asked.target.substr(0, asked.target.find('?')), .id = "req_1", .body = &body};
  request.headers = asked.headers;
  std::string_view query = asked.target;
  query.remove_prefix(std::min(query.size(), request.path.size() + 1));
  while (!query.empty()) {
    const std::string_view pair = query.substr(0, query.find('&'));
    const std::size_t equals = pair.find('=');
    request.query.emplace_back(pair.substr(0, equals), pair.substr(equals + 1));
    query.remove_prefix(std::min(pair.size() + 1, query.size()));
  }
  return api::handle(service, request);
}

std::string said(const api::Response& response) {
  const auto* text = std::get_if<std::string>(&response.body);
  return std::to_string(response.status) + (text != nullptr ? " " + text->substr(0, 400) : "");
}

TEST(Ranges, EveryNumberOfARequestHasOneInTheContract) {
  const auto all = request_numbers();
  EXPECT_GT(all.size(), 80U);
  for (const RequestNumber& number : all)
    EXPECT_FALSE(number.least.empty() || number.most.empty())
        << number.method << " " << number.path << " " << number.name;
}

TEST(Ranges, OfTheContractAreThoseThatAreKept) {
  for (const RequestNumber& number : request_numbers()) {
    if (number.least.empty() || number.most.empty()) continue;
    for (const bool low : {true, false}) {
      SCOPED_TRACE(number.method + " " + number.path + " " + number.variant + " " + number.name);
      // Which numbers of slices, files, sets and uploads there are is another question.
      const Asked good = asking(number, low, within(number, low));
      const api::Response taken = answer(number.method, good);
      EXPECT_NE(taken.status, 400) << good.target << " " << good.body << "\n" << said(taken);
      const Asked bad = asking(number, low, beyond(number, low));
      const api::Response refused = answer(number.method, bad);
      EXPECT_EQ(refused.status, number.in == "path" ? 404 : 400) << bad.target << " " << bad.body << "\n"
                                                                 << said(refused);
      const std::string name = number.name.substr(number.name[0] == '/' ? 1 : 0);
      EXPECT_NE(said(refused).find(number.in == "path" ? "slices" : name.substr(0, name.find('/'))), std::string::npos)
          << said(refused);
    }
  }
}

// In a header of a syntax of its own, which no schema describes.
TEST(Ranges, OfAWaitIsInTheContract) {
  EXPECT_NE(api::contract().find("N is a whole number " + ranges::wait_s.words()), std::string_view::npos);
}

TEST(Ranges, WhatIsNoNumberIsNone) {
  for (const RequestNumber& number : request_numbers()) {
    if (number.in != "query") continue;
    for (const char* word : {"nan", "inf", "-inf", "1e999", "0x10", "1_0", "", "1e", "99999999999999999999"}) {
      if (!number.whole && std::string(word) == "99999999999999999999" && std::stod(number.most) > 1e20) continue;
      const Asked asked = asking(number, true, word);
      // An end of a list that is left out leaves another list.
      if (number.items > 0 && *word == '\0') continue;
      EXPECT_EQ(answer(number.method, asked).status, 400) << number.method << " " << asked.target;
    }
  }
}

}  // namespace
}  // namespace spherule::test
