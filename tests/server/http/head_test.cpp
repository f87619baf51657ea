// SPDX-License-Identifier: GPL-3.0-or-later
//
// The strict reading of heads, bodies and forms, as pure functions of bytes.
#include "server/http/head.h"

#include <gtest/gtest.h>

#include <random>

#include "core/base/error.h"
#include "server/http/framing.h"
#include "server/http/multipart.h"

namespace spherule::server {
namespace {

// What a reader makes of bytes that come in pieces of these sizes, in turn: the head as text, or the status.
std::string read_head(const std::string& bytes, const std::vector<std::size_t>& pieces = {100'000},
                      const HeadLimits& limits = {}) {
  HeadReader reader(limits);
  std::size_t at = 0, turn = 0;
  while (at < bytes.size() && !reader.complete() && !reader.refusal()) {
    const std::string_view piece = std::string_view(bytes).substr(at, pieces[turn++ % pieces.size()]);
    const std::size_t taken = reader.feed(piece);
    if (!reader.complete() && !reader.refusal()) {
      EXPECT_EQ(taken, piece.size());
    }
    at += taken;
  }
  if (reader.refusal()) return std::to_string(reader.refusal()->status);
  if (!reader.complete()) return reader.begun() ? "begun" : "nothing";
  const Head head = reader.take();
  std::string text = head.method + " " + head.target + (head.version_1_0 ? " 1.0" : "");
  for (const auto& [name, value] : head.fields) text += "|" + name + "=" + value;
  if (!head.persistent) text += "|closes";
  if (head.expects_continue) text += "|expects";
  if (head.chunked) text += "|chunked";
  if (head.length > 0) text += "|" + std::to_string(head.length);
  return text + "|rest " + bytes.substr(at);
}

std::string with(const std::string& line) { return "POST /x HTTP/1.1\r\nHost: h\r\n" + line + "\r\n\r\n"; }

TEST(Head, SaysWhatARequestIs) {
  EXPECT_EQ(read_head("GET /a%20b?c=d HTTP/1.1\r\nHost: h:80\r\nA:\t b c \r\nA: %41\r\n\r\nrest"),
            "GET /a%20b?c=d|Host=h:80|A=b c|A=%41|rest rest");
  EXPECT_EQ(read_head("\r\nGET / HTTP/1.0\r\n\r\n"), "GET / 1.0|closes|rest ");
  EXPECT_EQ(read_head("GET / HTTP/1.0\r\nConnection: Keep-Alive\r\n\r\n"), "GET / 1.0|Connection=Keep-Alive|rest ");
  EXPECT_EQ(read_head(with("Connection: x, Close")), "POST /x|Host=h|Connection=x, Close|closes|rest ");
  EXPECT_EQ(read_head(with("content-length: 12")), "POST /x|Host=h|content-length=12|12|rest ");
  EXPECT_EQ(read_head(with("Transfer-Encoding: Chunked\r\nExpect: 100-Continue")),
            "POST /x|Host=h|Transfer-Encoding=Chunked|Expect=100-Continue|expects|chunked|rest ");
  EXPECT_EQ(read_head("GET http://other:8080/a?b HTTP/1.1\r\nHost: h\r\n\r\n"), "GET /a?b|Host=other:8080|rest ")
      << "a target that names the host goes before the field";
  EXPECT_EQ(read_head("OPTIONS * HTTP/1.1\r\nHost: [::1]:80\r\n\r\n"), "OPTIONS *|Host=[::1]:80|rest ");
  EXPECT_EQ(read_head(with("X: \xc3\xa9")), "POST /x|Host=h|X=\xc3\xa9|rest ");
  EXPECT_EQ(read_head(""), "nothing");
  EXPECT_EQ(read_head("GET / HTTP/1.1\r\nHost: h\r\n"), "begun");
}

TEST(Head, RefusesWhatTwoReadersReadDifferently) {
  for (const std::string& head :
       {with("Content-Length : 4"), with("A : b"), with(" A: b"), with("A: b\r\n c"), with("\tA: b"), with("A: b\n"),
        with("A: b\rC: d"), with("A: b\r"), with(std::string("A: b\0c", 6)), with("A\x01: b"), with(": b"), with("A"),
        with("A: \x7f"), std::string("GET / HTTP/1.1\nHost: h\n\n"), std::string("GET / HTTP/1.1\r\nHost: h\n\r\n"),
        std::string("\n\nGET / HTTP/1.1\r\nHost: h\r\n\r\n"), std::string("\r\n\r\nGET / HTTP/1.1\r\nHost: h\r\n\r\n"),
        with("Content-Length: +4"), with("Content-Length: -4"), with("Content-Length: 4x"), with("Content-Length: 0x4"),
        with("Content-Length:"), with("Content-Length: 4, 4"), with("Content-Length: 4\r\nContent-Length: 4"),
        with("Content-Length: 99999999999999999999"), with("Content-Length: 4\r\nTransfer-Encoding: chunked"),
        with("Transfer-Encoding: gzip, chunked"), with("Transfer-Encoding: xchunked"),
        with("Transfer-Encoding: identity"), with("Transfer-Encoding: chunked\r\nTransfer-Encoding: chunked"),
        with("Transfer-Encoding: \"chunked\""), std::string("POST / HTTP/1.0\r\nTransfer-Encoding: chunked\r\n\r\n"),
        // Of hosts.
        std::string("GET / HTTP/1.1\r\n\r\n"), std::string("GET / HTTP/1.1\r\nHost:\r\n\r\n"), with("Host: h"),
        std::string("GET / HTTP/1.1\r\nHost: a b\r\n\r\n"), std::string("GET / HTTP/1.1\r\nHost: h/x\r\n\r\n"),
        std::string("GET / HTTP/1.1\r\nHost: h@x\r\n\r\n"), std::string("GET / HTTP/1.1\r\nHost: h:8x\r\n\r\n"),
        std::string("GET http:///x HTTP/1.1\r\nHost: h\r\n\r\n"),
        // Of request lines.
        std::string("GET  / HTTP/1.1\r\nHost: h\r\n\r\n"), std::string("GET / HTTP/1.1 \r\nHost: h\r\n\r\n"),
        std::string(" GET / HTTP/1.1\r\nHost: h\r\n\r\n"), std::string("GET\t/ HTTP/1.1\r\nHost: h\r\n\r\n"),
        std::string("GET / HTTP/2.0\r\nHost: h\r\n\r\n"), std::string("GET / HTTP/1.10\r\nHost: h\r\n\r\n"),
        std::string("GET / http/1.1\r\nHost: h\r\n\r\n"), std::string("GET /\r\n\r\n"), std::string("nonsense\r\n\r\n"),
        std::string("GET x HTTP/1.1\r\nHost: h\r\n\r\n"), std::string("GET /a b HTTP/1.1\r\nHost: h\r\n\r\n"),
        std::string("GET /#f HTTP/1.1\r\nHost: h\r\n\r\n"), std::string("G(T / HTTP/1.1\r\nHost: h\r\n\r\n"),
        std::string("GET /\x01 HTTP/1.1\r\nHost: h\r\n\r\n")}) {
    EXPECT_EQ(read_head(head), "400") << head;
  }
  EXPECT_EQ(read_head(with("Expect: x")), "417");
}

TEST(Head, HasABudget) {
  EXPECT_EQ(read_head("GET /" + std::string(9000, 'a') + " HTTP/1.1\r\n"), "414");
  EXPECT_EQ(read_head("GET /" + std::string(40'000, 'a')), "414");
  EXPECT_EQ(read_head(with("A: " + std::string(40'000, 'a'))), "431");
  EXPECT_EQ(read_head("GET / HTTP/1.1\r\nA: " + std::string(40'000, 'a')), "431") << "without its end";
  std::string many;
  for (int i = 0; i < 98; ++i) many += "A: b\r\n";
  EXPECT_EQ(read_head(with(many + "A: b")).substr(0, 4), "POST");
  EXPECT_EQ(read_head(with(many + "A: b\r\nA: b")), "431");
  // Every byte counts, wherever it is cut.
  HeadReader reader({.bytes = 1000});
  std::size_t fed = 0;
  while (!reader.refusal() && fed < 5000) fed += reader.feed(fed == 0 ? "GET / HTTP/1.1\r\n" : "A:b\r\n");
  EXPECT_LE(fed, 1000U);
  EXPECT_EQ(reader.refusal()->status, 431);
}

TEST(Head, IsTheSameHoweverItIsCut) {
  std::mt19937 random(5);
  const std::string good =
      "POST /a?b=c HTTP/1.1\r\nHost: h\r\nContent-Length: 5\r\nA: b\r\nConnection: close\r\n\r\nhello";
  for (int i = 0; i < 3000; ++i) {
    std::string bytes = good;
    for (unsigned k = random() % 4; k > 0; --k) {
      const std::size_t at = random() % bytes.size();
      const std::string evil =
          std::vector<std::string>{"\r", "\n", "\r\n", " ", ":", std::string(1, '\0'), "\t", ","}[random() % 8];
      random() % 2 ? bytes.insert(at, evil) : bytes.replace(at, 1, evil);
    }
    const std::string whole = read_head(bytes);
    EXPECT_EQ(read_head(bytes, {1}), whole) << bytes;
    EXPECT_EQ(read_head(bytes, {1 + random() % 9, 1 + random() % 30}), whole) << bytes;
  }
}

TEST(Head, NamesHosts) {
  EXPECT_EQ(host_name("LocalHost:8080"), "localhost");
  EXPECT_EQ(host_name("127.0.0.1"), "127.0.0.1");
  EXPECT_EQ(host_name("[::1]:80"), "[::1]");
  for (const char* none : {"", ":80", "[::1", "[x]", "a b", "h:x", "[::1]x", "user@h"})
    EXPECT_FALSE(host_name(none)) << none;
}

TEST(Head, DecodesTargetsOnce) {
  const Target target = parse_target("/a%2Fb%2541/%?x=1+2&y=%2B&%7a&&z==&bad=%4");
  EXPECT_EQ(target.path, "/a/b%41/%");
  EXPECT_EQ(target.query, (Fields{{"x", "1 2"}, {"y", "+"}, {"z", ""}, {"z", "="}, {"bad", "%4"}}));
  EXPECT_EQ(parse_target("/a").path, "/a");
}

// The content of a chunked body in pieces of this size, and how it ends.
std::string unchunk(const std::string& bytes, std::size_t piece) {
  Head head;
  head.chunked = true;
  BodyFraming framing(head);
  std::string content;
  std::size_t at = 0;
  while (at < bytes.size() && !framing.finished() && !framing.bad()) {
    const std::string_view next = std::string_view(bytes).substr(at, piece);
    for (std::size_t used = 0; used < next.size();) {
      const BodyFraming::Step step = framing.next(next.substr(used));
      content += step.content;
      used += step.taken;
      at += step.taken;
      if (step.taken == 0) break;
    }
  }
  return content + (framing.finished() ? "|rest " + bytes.substr(at) : framing.bad() ? "|bad" : "|more");
}

TEST(Framing, ReadsChunks) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"5\r\nhello\r\n6\r\n world\r\n0\r\n\r\nGET", "hello world|rest GET"},
      {"A;x=\"y\"\r\n0123456789\r\n0\r\nTrailer: x\r\n\r\n", "0123456789|rest "},
      {"00005\r\nhello\r\n000\r\n\r\n", "hello|rest "},
      {"5\r\nhel", "hel|more"},
      {"5\nhello\r\n0\r\n\r\n", "|bad"},
      {"5\r\nhello\n0\r\n\r\n", "hello|bad"},
      {"5\r\nhelloX\r\n0\r\n\r\n", "hello|bad"},
      {"5\r\nhello0\r\n\r\n", "hello|bad"},
      {"5 \r\nhello\r\n0\r\n\r\n", "|bad"},
      {"\r\nhello", "|bad"},
      {"-5\r\nhello\r\n0\r\n\r\n", "|bad"},
      {"0x5\r\nhello\r\n0\r\n\r\n", "|bad"},
      {"5;a\nb\r\nhello\r\n0\r\n\r\n", "|bad"},
      {"ffffffffffffffff\r\nhello", "|bad"},
      {"0\r\n\n", "|bad"},
      {"0\r\nno field\r\n\r\n", "|bad"},
      {"0\r\nA: b\n\r\n", "|bad"},
      {"0\r\n folded: x\r\n\r\n", "|bad"},
      {"5;" + std::string(5000, 'x'), "|bad"},
      {"0\r\nA: " + std::string(5000, 'x'), "|bad"},
  };
  for (const auto& [bytes, expected] : cases) {
    for (const std::size_t piece : {std::size_t{1}, std::size_t{2}, std::size_t{7}, bytes.size()}) {
      EXPECT_EQ(unchunk(bytes, piece), expected) << bytes.substr(0, 60) << " in pieces of " << piece;
    }
  }
  std::string many;
  for (int i = 0; i < 2000; ++i) many += "1;xyz\r\na\r\n";
  EXPECT_TRUE(unchunk(many + "0\r\n\r\n", 100).ends_with("|bad")) << "extensions have a budget for all chunks together";
}

TEST(Framing, CountsLengths) {
  Head head;
  EXPECT_TRUE(BodyFraming(head).finished());
  head.length = 5;
  BodyFraming framing(head);
  EXPECT_EQ(framing.next("hel").content, "hel");
  const BodyFraming::Step last = framing.next("loGET");
  EXPECT_EQ(last.content, "lo");
  EXPECT_EQ(last.taken, 2U);
  EXPECT_TRUE(framing.finished());
}

std::string read_form(const std::string& type, const std::string& bytes, std::size_t piece) {
  MultipartReader reader(type);
  std::string seen;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    reader.feed(
        std::string_view(bytes).substr(at, piece),
        [&](std::string_view name, std::string_view filename) {
          seen += "[" + std::string(name) + "," + std::string(filename) + "]";
        },
        [&](std::string_view content) { seen += content; });
  }
  return seen + (reader.ended() ? "" : "|more");
}

TEST(Multipart, TakesFormsApart) {
  const std::string type = "multipart/form-data; charset=x; boundary=\"b b\"";
  const std::string form =
      "preamble\r\n--b b\r\nContent-Disposition: form-data; name=\"file\"; filename=\"a;\\\"b.nii\"\r\nContent-Type: "
      "x/y\r\n\r\n"
      "one\r\n--b\r\n\r\n--b b \r\ncontent-disposition: form-data; name=file\r\n\r\n\r\n--b b--\r\nepilogue --b b";
  for (const std::size_t piece : {std::size_t{1}, std::size_t{3}, std::size_t{10}, form.size()}) {
    EXPECT_EQ(read_form(type, form, piece), "[file,a;\"b.nii]one\r\n--b\r\n[file,]") << piece;
    EXPECT_EQ(read_form(type, "--b b\r\nContent-Disposition: form-data; name=\"f\"\r\n\r\nx\r\n--b b--", piece),
              "[f,]x");
    EXPECT_EQ(read_form(type, "--b b\r\nContent-Disposition: form-data; name=\"f\"\r\n\r\nxyz\r\n--b", piece),
              "[f,]xy|more")
        << "what may be a delimiter waits";
  }
  EXPECT_EQ(read_form("multipart/form-data; boundary=b", "--b--\r\n", 1), "");
}

TEST(Multipart, RefusesWhatIsNoForm) {
  const std::string type = "multipart/form-data; boundary=b",
                    head = "--b\r\nContent-Disposition: form-data; name=\"f\"\r\n";
  for (const std::string& bad :
       {std::string(10'000, '-'), std::string("--bx\r\n"), std::string("--b\r\n\r\nx"),
        std::string("--b\r\nno field\r\n\r\n"), head + "A : b\r\n\r\n", head + " folded\r\n\r\n",
        "--b\r\nA: " + std::string(10'000, 'x'), "--b" + std::string(10'000, ' '),
        head + "\r\nx\r\n--b-"
               "x"}) {
    for (const std::size_t piece : {std::size_t{1}, bad.size()}) {
      EXPECT_THROW(read_form(type, bad, piece), Error) << bad.substr(0, 60);
    }
  }
  for (const char* none :
       {"multipart/form-data", "multipart/form-data; boundary=", "multipart/form-data; x=boundary=b"}) {
    EXPECT_THROW(MultipartReader{none}, Error) << none;
  }
}

}  // namespace
}  // namespace spherule::server
